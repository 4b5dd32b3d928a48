#pragma once

#include <string>

#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// The result for a terminal: a line per camera with the residual before and after, the tracks, the
/// verdict, the change against `initial` (rotation in degrees, translation in centimetres, as
/// lengths) and one standard deviation of the same; below it the reasons. Ends with a newline.
std::string FormatResultTable(const Rig& initial, const CalibrationResult& result);

/// The errors of `initial` and of the result against a known truth, a line per camera of the truth:
/// rotation in degrees, translation in centimetres, end-to-end reprojection in pixels, focal length
/// in per cent and principal point in pixels, each before and after (rig_comparison.h). A camera
/// that cannot be compared says why.
std::string FormatTruthTable(const Rig& truth, const Rig& initial, const Rig& estimate);

}  // namespace scenecalib
