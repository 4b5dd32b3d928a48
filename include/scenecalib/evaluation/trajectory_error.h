#pragma once

#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/geometry/trajectory.h"

namespace scenecalib {

/// Error of the motion over a window of time: the RMS over all windows, starting every 20 ms, of
/// inverse(true lidar(t) <- lidar(t + window)) * (estimated). What calibration depends on, where
/// the absolute error does not matter.
struct RelativeMotionError {
  double window_s = 0.0;
  double translation_m = 0.0;
  double rotation_rad = 0.0;
  double max_translation_m = 0.0;  ///< of the worst window
  int num_windows = 0;
};

/// One entry per window, in the order given, over the time that both trajectories cover.
/// InsufficientData when that is shorter than a window.
Result<std::vector<RelativeMotionError>> CompareRelativeMotion(
    const Trajectory& truth, const Trajectory& estimate, const std::vector<double>& windows_s);

/// Error over stretches of a travelled length (metres, by the truth), from every 0.1 s on, as a
/// share of that length: KITTI's measure of drift. Rotation in rad per metre. InsufficientData when
/// the common drive is shorter.
struct DriftError {
  double length_m = 0.0;
  double translation_share = 0.0;
  double rotation_rad_m = 0.0;
  int num_stretches = 0;
};
Result<DriftError> CompareDrift(const Trajectory& truth, const Trajectory& estimate,
                                double length_m);

}  // namespace scenecalib
