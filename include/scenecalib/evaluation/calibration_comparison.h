#pragma once

#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/calibration/calibration_result.h"

namespace scenecalib {

/// How far one parameter of a camera is from one calibration to another.
struct ParameterChange {
  std::string parameter;  ///< "shift right", "turn yaw", "focal scale", ...
  std::string unit;       ///< "cm", "deg", "%", "px", "ms"
  double change = 0.0;    ///< second minus first; of the pose in the first one's camera axes
  double stddev = 0.0;    ///< of the change: both standard deviations together
  double sigmas = 0.0;    ///< |change| / stddev
  bool moved = false;     ///< by more than the limits
};

struct CameraChange {
  std::string camera;
  /// Why it cannot be compared (missing, not accepted, another lens model); empty when it can.
  std::string problem;
  std::vector<ParameterChange> parameters;
  bool moved = false;
};

/// A parameter counts as moved when its change exceeds both.
struct ComparisonLimits {
  double sigmas = 3.0;
  /// Standard deviations are widened by this.
  double stddev_factor = 1.0;
};

/// Every camera of `first` against that of the same name in `second`; cameras that only `second`
/// has come last. A camera that is not accepted in both is not compared: its values are not a
/// measurement.
std::vector<CameraChange> CompareCalibrations(const CalibrationResult& first,
                                              const CalibrationResult& second,
                                              const ComparisonLimits& limits);

/// For a terminal: a line per camera that says what moved, on which axis, by how many sigma, and
/// then every parameter.
std::string FormatChanges(const std::vector<CameraChange>& changes);

}  // namespace scenecalib
