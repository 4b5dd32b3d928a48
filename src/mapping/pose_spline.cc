#include "scenecalib/mapping/pose_spline.h"

#include <algorithm>
#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {

PoseSpline::PoseSpline(const Trajectory& map_from_lidar, double knot_interval_s)
    : start_ns_(map_from_lidar.start_ns()),
      end_ns_(map_from_lidar.end_ns()),
      knot_interval_s_(knot_interval_s) {
  const double duration_s = SecondsBetween(start_ns_, end_ns_);
  const int num_intervals = std::max(static_cast<int>(std::ceil(duration_s / knot_interval_s)), 1);
  for (int k = -1; k <= num_intervals + 1; ++k) {
    const Timestamp stamp_ns = AddSeconds(start_ns_, k * knot_interval_s);
    if (map_from_lidar.Covers(stamp_ns)) {
      controls_.push_back(*map_from_lidar.Interpolate(stamp_ns));
      continue;
    }
    // Beyond an end the motion of the last knot interval goes on.
    const Timestamp end_ns = stamp_ns < start_ns_ ? start_ns_ : end_ns_;
    const Timestamp inner_ns =
        std::clamp(AddSeconds(end_ns, stamp_ns < start_ns_ ? knot_interval_s : -knot_interval_s),
                   start_ns_, end_ns_);
    const Rigid3 end = *map_from_lidar.Interpolate(end_ns);
    const Rigid3 inner = *map_from_lidar.Interpolate(inner_ns);
    const double interval_s = SecondsBetween(inner_ns, end_ns);
    const double factor = interval_s == 0.0 ? 0.0 : SecondsBetween(end_ns, stamp_ns) / interval_s;
    const Eigen::Vector3d turn = LogSo3(inner.rotation.conjugate() * end.rotation);
    controls_.emplace_back(end.rotation * ExpSo3(factor * turn),
                           end.translation + factor * (end.translation - inner.translation));
  }
}

PoseSpline::Basis PoseSpline::BasisAt(double seconds) const {
  Basis basis;
  const double position = seconds / knot_interval_s_;
  basis.first =
      std::clamp(static_cast<int>(std::floor(position)), 0, static_cast<int>(controls_.size()) - 4);
  const double u = position - basis.first;
  const double v = 1.0 - u;
  const double h = knot_interval_s_;
  basis.weight = {v * v * v / 6.0, (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
                  (-3.0 * u * u * u + 3.0 * u * u + 3.0 * u + 1.0) / 6.0, u * u * u / 6.0};
  basis.velocity = {-0.5 * v * v / h, (1.5 * u * u - 2.0 * u) / h, (-1.5 * u * u + u + 0.5) / h,
                    0.5 * u * u / h};
  basis.acceleration = {v / (h * h), (3.0 * u - 2.0) / (h * h), (1.0 - 3.0 * u) / (h * h),
                        u / (h * h)};
  return basis;
}

Rigid3 PoseSpline::PoseAt(double seconds) const { return StateAt(seconds).map_from_lidar; }

SplineState PoseSpline::StateAt(double seconds) const {
  const Basis basis = BasisAt(seconds);
  SplineState state;
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  for (int j = 0; j < 4; ++j) {
    const Eigen::Vector3d& control = controls_[basis.first + j].translation;
    translation += basis.weight[j] * control;
    state.acceleration_in_map += basis.acceleration[j] * control;
  }
  Eigen::Quaterniond rotation = controls_[basis.first].rotation;
  // Cumulative weights: from control j-1 to j goes the share of all later weights.
  double share = 1.0;
  double share_rate = 0.0;
  for (int j = 1; j < 4; ++j) {
    share -= basis.weight[j - 1];
    share_rate -= basis.velocity[j - 1];
    const Eigen::Vector3d turn = LogSo3(controls_[basis.first + j - 1].rotation.conjugate() *
                                        controls_[basis.first + j].rotation);
    const Eigen::Quaterniond step = ExpSo3(share * turn);
    rotation = rotation * step;
    state.angular_velocity_in_lidar =
        step.conjugate() * state.angular_velocity_in_lidar + share_rate * turn;
  }
  state.map_from_lidar = Rigid3(rotation, translation);
  return state;
}

std::vector<TimedPose> PoseSpline::Sample(double step_s) const {
  const double duration_s = SecondsBetween(start_ns_, end_ns_);
  const int num_steps = std::max(static_cast<int>(std::ceil(duration_s / step_s)), 1);
  std::vector<TimedPose> poses;
  poses.reserve(num_steps + 1);
  for (int i = 0; i <= num_steps; ++i) {
    const Timestamp stamp_ns =
        i == num_steps ? end_ns_ : AddSeconds(start_ns_, duration_s * i / num_steps);
    poses.push_back({stamp_ns, PoseAt(SecondsBetween(start_ns_, stamp_ns))});
  }
  return poses;
}

}  // namespace scenecalib
