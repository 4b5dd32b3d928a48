#include "scenecalib/geometry/trajectory.h"

#include <algorithm>
#include <string>
#include <utility>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {

Result<Trajectory> Trajectory::Create(std::vector<TimedPose> poses) {
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const Rigid3& pose = poses[i].map_from_lidar;
    if (!pose.translation.allFinite() || !pose.rotation.coeffs().allFinite()) {
      return Status::InvalidArgument("trajectory pose " + std::to_string(i) + " is not finite");
    }
    if (i > 0 && poses[i].stamp_ns <= poses[i - 1].stamp_ns) {
      return Status::InvalidArgument("trajectory stamps do not increase at pose " +
                                     std::to_string(i));
    }
  }
  Trajectory trajectory;
  trajectory.poses_ = std::move(poses);
  return trajectory;
}

std::optional<Rigid3> Trajectory::Interpolate(Timestamp stamp_ns) const {
  if (!Covers(stamp_ns)) return std::nullopt;
  const auto after = std::lower_bound(
      poses_.begin(), poses_.end(), stamp_ns,
      [](const TimedPose& pose, Timestamp stamp) { return pose.stamp_ns < stamp; });
  if (after->stamp_ns == stamp_ns) return after->map_from_lidar;
  const auto before = std::prev(after);
  const double fraction = static_cast<double>(stamp_ns - before->stamp_ns) /
                          static_cast<double>(after->stamp_ns - before->stamp_ns);
  return InterpolateRigid3(before->map_from_lidar, after->map_from_lidar, fraction);
}

double Trajectory::Length() const {
  double length_m = 0.0;
  for (std::size_t i = 1; i < poses_.size(); ++i) {
    length_m +=
        (poses_[i].map_from_lidar.translation - poses_[i - 1].map_from_lidar.translation).norm();
  }
  return length_m;
}

}  // namespace scenecalib
