#pragma once

#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/io/rig_yaml.h"

namespace scenecalib {

/// IV-D: cameras that were not accepted take their values from the result of another recording of
/// the same vehicle, and say so. Only from a camera of the same name and image size that was
/// accepted there; otherwise the initial values stay, and the reasons say why.
void ApplyFallback(const CalibrationResult& fallback, const std::string& fallback_name,
                   CalibrationResult* result);

}  // namespace scenecalib
