#pragma once

#include <limits>
#include <string>
#include <vector>

#include "scenecalib/calibration/calibration_options.h"
#include "scenecalib/calibration/clock_misfit.h"
#include "scenecalib/calibration/joint_calibration.h"
#include "scenecalib/calibration/radial_misfit.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// Held-out RMSE before and after, over the same tracks on the same planes.
struct HeldOutRms {
  int num_tracks = 0;
  double before_px = std::numeric_limits<double>::infinity();
  double after_px = std::numeric_limits<double>::infinity();
};

/// Reasons against the camera; none means that it is accepted.
std::vector<std::string> Objections(const CameraConfig& initial, const CameraQuality& quality,
                                    const JointCameraEvidence& evidence, const HeldOutRms& held_out,
                                    const Rigid3& result, const AcceptanceOptions& options);

/// Says in words which directions the drive did not show.
std::vector<std::string> WeakDirections(const CameraStddev& stddev,
                                        const AcceptanceOptions& options);

/// Something that the rig file says of a camera, against what its images say.
struct MisfitVerdict {
  std::string text;     ///< what is wrong and what to do; empty when they agree
  bool is_bad = false;  ///< too much to accept the camera
};

/// The lens.
MisfitVerdict JudgeLens(const RadialMisfit& lens);
/// The rows against each other. Tracks that fit a global shutter least count least, so that what is
/// seen of another one is on the low side.
MisfitVerdict JudgeShutter(const ClockMisfit& clock, const CameraConfig& initial);
/// The images against the lidar.
MisfitVerdict JudgeTimeOffset(const ClockMisfit& clock, const CameraConfig& initial);

}  // namespace scenecalib
