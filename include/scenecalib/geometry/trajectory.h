#pragma once

#include <optional>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/base/timestamp.h"
#include "scenecalib/geometry/rigid3.h"

namespace scenecalib {

/// A pose at a time. What maps to what is said by the trajectory that owns it.
struct TimedPose {
  Timestamp stamp_ns = 0;
  Rigid3 map_from_lidar;
};

/// The lidar's motion, map_from_lidar(t), as dense samples in strictly increasing time. Between two
/// samples rotation is slerped and translation is linear, so the samples must be dense against the
/// motion (mapping emits one every 10 ms or denser). It never extrapolates.
class Trajectory {
 public:
  Trajectory() = default;

  /// InvalidArgument when stamps do not strictly increase or a pose is not finite.
  static Result<Trajectory> Create(std::vector<TimedPose> poses);

  bool empty() const { return poses_.empty(); }
  const std::vector<TimedPose>& poses() const { return poses_; }
  Timestamp start_ns() const { return poses_.front().stamp_ns; }
  Timestamp end_ns() const { return poses_.back().stamp_ns; }
  bool Covers(Timestamp stamp_ns) const {
    return !poses_.empty() && stamp_ns >= start_ns() && stamp_ns <= end_ns();
  }

  /// map_from_lidar at the stamp (lidar clock); none outside [start, end].
  std::optional<Rigid3> Interpolate(Timestamp stamp_ns) const;

  /// Metres travelled, summed over samples.
  double Length() const;

 private:
  std::vector<TimedPose> poses_;
};

}  // namespace scenecalib
