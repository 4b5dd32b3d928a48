#pragma once

namespace scenecalib {

/// evaluate_calibration: the miscalibration rates of any rig files on a recording. Exit status 0,
/// or 1 when nothing could be computed.
int RunEvaluateCalibration(int argc, char** argv);

/// compare: what moved between calibrations of one vehicle. Exit status 0 nothing moved, 2
/// something did, 1 a file cannot be read.
int RunCompare(int argc, char** argv);

/// study: calibrates one recording from many starts. Exit status 0, or 1 when nothing could be
/// calibrated.
int RunStudy(int argc, char** argv);

}  // namespace scenecalib
