#pragma once

#include <string>

#include "scenecalib/base/status.h"
#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// Reads a rig file, or a calibration file (its quality blocks are checked for form and ignored),
/// in the schema of docs/ros_api.md. Any unknown, missing, mistyped or out-of-range key is
/// InvalidArgument naming file, key, value and bound. A camera without `intrinsics` must name a
/// camera_info_topic; its model is then null.
Result<Rig> ReadRig(const std::string& path);

/// As ReadRig, from text; `source_name` stands for the file in messages.
Result<Rig> ParseRig(const std::string& yaml_text, const std::string& source_name);

/// Reads a calibration file with its quality blocks. InvalidArgument as for ReadRig, and for a rig
/// file without them.
Result<CalibrationResult> ReadCalibration(const std::string& path);

/// The rig alone, without quality: for simulated rigs and truths.
std::string FormatRig(const Rig& rig);
Status WriteRig(const std::string& path, const Rig& rig);

/// The output schema: the rig with quality blocks. Written to a temporary file and renamed.
std::string FormatCalibration(const CalibrationResult& result);
Status WriteCalibration(const std::string& path, const CalibrationResult& result);

}  // namespace scenecalib
