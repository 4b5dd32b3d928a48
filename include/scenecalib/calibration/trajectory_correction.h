#pragma once

#include <utility>
#include <vector>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/calibration/transfer_error.h"
#include "scenecalib/geometry/rigid3.h"

namespace scenecalib {

/// A small, smooth correction c(t) of the lidar trajectory, linear between knots; the corrected
/// pose is map_from_lidar(t) * (Exp(c_r), c_t). Shared by all cameras. Differs from the paper,
/// which holds the trajectory fixed; with every knot at zero it is the paper.
class TrajectoryCorrection {
 public:
  TrajectoryCorrection() = default;
  /// Zero everywhere, with knots from start to at least end.
  TrajectoryCorrection(Timestamp start_ns, Timestamp end_ns, double knot_spacing_s);

  /// Where a stamp lies: c(t) = (1 - fraction) * knot[index] + fraction * knot[index + 1]. A stamp
  /// outside the knots takes the nearest one's value.
  struct Place {
    int index = 0;
    double fraction = 0.0;
  };
  Place Locate(Timestamp stamp_ns) const;

  Vector6d At(const Place& place) const;
  Vector6d At(Timestamp stamp_ns) const { return At(Locate(stamp_ns)); }

  /// map_from_lidar with the correction at its stamp applied.
  Rigid3 Apply(const Rigid3& map_from_lidar, Timestamp stamp_ns) const;

  bool empty() const { return knots_.empty(); }
  double knot_spacing_s() const { return knot_spacing_s_; }
  std::vector<Vector6d>& knots() { return knots_; }
  const std::vector<Vector6d>& knots() const { return knots_; }

 private:
  Timestamp start_ns_ = 0;
  double knot_spacing_s_ = 0.1;
  std::vector<Vector6d> knots_;
};

/// The pose with a correction applied: map_from_lidar * (Exp(c_r), c_t).
Rigid3 ApplyCorrection(const Rigid3& map_from_lidar, const Vector6d& correction);

}  // namespace scenecalib
