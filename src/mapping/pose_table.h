#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <vector>

#include "scenecalib/geometry/trajectory.h"

namespace scenecalib {

/// A trajectory sampled so densely that matrices may be interpolated linearly: millions of points
/// are placed with it. At 2 ms and 1 rad/s the shortcut costs 5e-7 of a point's range.
class PoseTable {
 public:
  explicit PoseTable(const Trajectory& map_from_lidar) : start_ns_(map_from_lidar.start_ns()) {
    const double duration_s = SecondsBetween(start_ns_, map_from_lidar.end_ns());
    const int num_steps = std::max(static_cast<int>(std::ceil(duration_s / kStepS)), 1);
    step_s_ = duration_s > 0.0 ? duration_s / num_steps : kStepS;
    for (int i = 0; i <= num_steps; ++i) {
      const Timestamp stamp_ns =
          i == num_steps ? map_from_lidar.end_ns() : AddSeconds(start_ns_, i * step_s_);
      const Rigid3 pose = *map_from_lidar.Interpolate(std::min(stamp_ns, map_from_lidar.end_ns()));
      Matrix34d matrix;
      matrix << pose.RotationMatrix(), pose.translation;
      poses_.push_back(matrix);
    }
  }

  /// Seconds since start_ns of a time; beyond the ends the pose of the end holds.
  Eigen::Vector3d Place(const Eigen::Vector3d& point_in_lidar, double seconds) const {
    const Matrix34d pose = At(seconds);
    return pose.leftCols<3>() * point_in_lidar + pose.col(3);
  }
  Timestamp start_ns() const { return start_ns_; }

 private:
  using Matrix34d = Eigen::Matrix<double, 3, 4>;
  static constexpr double kStepS = 0.002;

  Matrix34d At(double seconds) const {
    const double position =
        std::clamp(seconds / step_s_, 0.0, static_cast<double>(poses_.size() - 1));
    const auto before = std::min(static_cast<std::size_t>(position), poses_.size() - 2);
    const double fraction = position - static_cast<double>(before);
    return (1.0 - fraction) * poses_[before] + fraction * poses_[before + 1];
  }

  Timestamp start_ns_;
  double step_s_ = kStepS;
  std::vector<Matrix34d> poses_;
};

}  // namespace scenecalib
