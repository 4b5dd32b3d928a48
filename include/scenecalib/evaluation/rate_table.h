#pragma once

#include <optional>
#include <string>
#include <vector>

#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// The miscalibration rates of one rig, for a table.
struct RatedRig {
  std::string name;                                      ///< of its file
  std::vector<std::optional<MiscalibrationRate>> rates;  ///< parallel to the cameras
};

/// A line per camera and rig, then the means by field of view beside Table I of the paper.
/// `cameras` gives names and fields of view.
std::string FormatRateTable(const std::vector<CameraConfig>& cameras,
                            const std::vector<RatedRig>& rigs);

/// The same as YAML: rig, camera, axis.
std::string FormatRateYaml(const std::vector<CameraConfig>& cameras,
                           const std::vector<RatedRig>& rigs);

}  // namespace scenecalib
