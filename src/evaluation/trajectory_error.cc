#include "scenecalib/evaluation/trajectory_error.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr Timestamp kWindowStepNs = 20000000;
constexpr Timestamp kStretchStepNs = 100000000;

/// lidar_true(to) <- lidar_estimated(to), both having started together at `from`.
Rigid3 MotionError(const Trajectory& truth, const Trajectory& estimate, Timestamp from,
                   Timestamp to) {
  const Rigid3 true_motion = truth.Interpolate(from)->Inverse() * *truth.Interpolate(to);
  const Rigid3 motion = estimate.Interpolate(from)->Inverse() * *estimate.Interpolate(to);
  return true_motion.Inverse() * motion;
}

struct Overlap {
  Timestamp start_ns = 0;
  Timestamp end_ns = -1;
};

Overlap CommonTime(const Trajectory& truth, const Trajectory& estimate) {
  if (truth.empty() || estimate.empty()) return {};
  return {std::max(truth.start_ns(), estimate.start_ns()),
          std::min(truth.end_ns(), estimate.end_ns())};
}

}  // namespace

Result<std::vector<RelativeMotionError>> CompareRelativeMotion(
    const Trajectory& truth, const Trajectory& estimate, const std::vector<double>& windows_s) {
  const Overlap overlap = CommonTime(truth, estimate);
  std::vector<RelativeMotionError> errors;
  for (const double window_s : windows_s) {
    RelativeMotionError error;
    error.window_s = window_s;
    double sum_translation = 0.0;
    double sum_rotation = 0.0;
    for (Timestamp from = overlap.start_ns; AddSeconds(from, window_s) <= overlap.end_ns;
         from += kWindowStepNs) {
      const Rigid3 off = MotionError(truth, estimate, from, AddSeconds(from, window_s));
      sum_translation += off.translation.squaredNorm();
      sum_rotation += LogSo3(off.rotation).squaredNorm();
      error.max_translation_m = std::max(error.max_translation_m, off.translation.norm());
      ++error.num_windows;
    }
    if (error.num_windows == 0) {
      return Status::InsufficientData("the trajectories share less than " +
                                      std::to_string(window_s) + " s");
    }
    error.translation_m = std::sqrt(sum_translation / error.num_windows);
    error.rotation_rad = std::sqrt(sum_rotation / error.num_windows);
    errors.push_back(error);
  }
  return errors;
}

Result<DriftError> CompareDrift(const Trajectory& truth, const Trajectory& estimate,
                                double length_m) {
  const Overlap overlap = CommonTime(truth, estimate);
  std::vector<Timestamp> stamps;
  std::vector<double> travelled_m;
  for (Timestamp stamp = overlap.start_ns; stamp <= overlap.end_ns; stamp += kStretchStepNs) {
    const double step = stamps.empty() ? 0.0
                                       : (truth.Interpolate(stamp)->translation -
                                          truth.Interpolate(stamps.back())->translation)
                                             .norm();
    travelled_m.push_back(travelled_m.empty() ? 0.0 : travelled_m.back() + step);
    stamps.push_back(stamp);
  }
  DriftError error;
  error.length_m = length_m;
  for (std::size_t i = 0; i < stamps.size(); ++i) {
    const auto end =
        std::lower_bound(travelled_m.begin(), travelled_m.end(), travelled_m[i] + length_m);
    if (end == travelled_m.end()) break;
    const auto j = static_cast<std::size_t>(end - travelled_m.begin());
    const double length = travelled_m[j] - travelled_m[i];
    const Rigid3 off = MotionError(truth, estimate, stamps[i], stamps[j]);
    error.translation_share += off.translation.norm() / length;
    error.rotation_rad_m += LogSo3(off.rotation).norm() / length;
    ++error.num_stretches;
  }
  if (error.num_stretches == 0) {
    return Status::InsufficientData("the common drive is shorter than " + std::to_string(length_m) +
                                    " m");
  }
  error.translation_share /= error.num_stretches;
  error.rotation_rad_m /= error.num_stretches;
  return error;
}

}  // namespace scenecalib
