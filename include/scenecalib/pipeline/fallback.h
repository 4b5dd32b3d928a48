#pragma once

#include <optional>
#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// A calibration that stays in force where a new one is not accepted (IV-D).
struct EarlierCalibration {
  std::string name;  ///< for a person: its file, or how it came about
  CalibrationResult result;
};

/// What the rig file's `fallback` names, none when it names nothing. NotFound and the like, naming
/// the file, when that cannot be read.
Result<std::optional<EarlierCalibration>> ReadFallback(const Rig& rig);

/// Cameras that were not accepted take their values from the first of the earlier calibrations that
/// accepted a camera of the same name and image size, and say so. Otherwise the initial values
/// stay, and the reasons say why; with no earlier calibration at all nothing changes. Tells for
/// every camera whether it took earlier values.
std::vector<bool> ApplyFallback(const std::vector<EarlierCalibration>& earlier,
                                CalibrationResult* result);

/// Hands the values of the cameras that `result` accepted on to `in_force`, which keeps those of
/// the others. Both are of one rig; an empty `in_force` becomes one that accepts nothing yet.
void TakeAccepted(const CalibrationResult& result, CalibrationResult* in_force);

/// "; FILE stays in force" of the first one, to end the message of a run that gave no result; empty
/// without one.
std::string StaysInForce(const std::vector<EarlierCalibration>& earlier);

}  // namespace scenecalib
