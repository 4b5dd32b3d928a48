#pragma once

#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/calibration/calibration_options.h"
#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// What one stretch of a long recording made of the rig.
struct StretchCalibration {
  std::string name;  ///< for a person: "stretch 2 (at 512 s)"
  CalibrationResult result;
};

/// One calibration from those of several stretches, each made from the same initial rig on its own
/// map: every camera's parameters are averaged with the inverse of their covariances as weights,
/// the prior, which is part of each, counted once. So what one stretch shows (turns: the forward
/// offset) and another one does not ends as well known as where it was seen best, and the memory is
/// that of one stretch.
///
/// The stretches check each other: one whose result is further from the others' mean than
/// `kMaxStretchSigmas` standard deviations of the difference, on any parameter, is left out where
/// at least two others remain, and named. Two that contradict each other leave the camera at its
/// initial values: not accepted. A spread larger than stated widens the standard deviations.
///
/// A camera that was accepted on no stretch has the reasons of the best one. `stretches` is ordered
/// from best to worst; counts of tracks are summed, residuals are the best one's, the
/// miscalibration rates are absent (they belong to one stretch's map). InvalidArgument without a
/// stretch or when one has other cameras.
///
/// Differs from the paper, which solves all segments in one problem: there the lidar's map is one
/// too.
Result<CalibrationResult> CombineStretches(const Rig& initial, const PriorOptions& prior,
                                           const std::vector<StretchCalibration>& stretches);

/// Beyond this the results of two stretches are not of one and the same camera.
constexpr double kMaxStretchSigmas = 5.0;

}  // namespace scenecalib
