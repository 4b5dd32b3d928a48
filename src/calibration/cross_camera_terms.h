#pragma once

#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/calibration/calibration_options.h"
#include "scenecalib/calibration/joint_calibration.h"

namespace scenecalib {

/// What a camera's images are worth to others: its model at the present intrinsics, its poses, and
/// the points of its tracks in `terms` where their reference rays meet their planes. `track_of`
/// says which track each point belongs to.
Result<MatchingCamera> PrepareForMatching(const JointCamera& camera, int index,
                                          const JointCalibration& joint,
                                          const std::vector<TransferTerm>& terms,
                                          const Trajectory& map_from_lidar,
                                          std::vector<int>* track_of);

/// Finds joint->cross_camera anew at the present solution from the inlier terms of all cameras;
/// afterwards a match's source_point is the index of the source's track.
Status MatchCameras(const std::vector<JointCamera>& cameras, const Trajectory& map_from_lidar,
                    const RayCaster& caster, const std::vector<TransferTerm>& terms,
                    const CrossCameraOptions& options, JointCalibration* joint);

/// The matches as terms: the source's reference pixel over its track's plane into the other camera.
/// Whitened, normalised by the target camera's own sigma, gated. Matches whose track is not among
/// `terms` at present are left out.
std::vector<TransferTerm> BuildCrossTerms(const std::vector<TransferTerm>& terms,
                                          const Trajectory& map_from_lidar,
                                          const CalibrationOptions& options,
                                          JointCalibration* joint);

}  // namespace scenecalib
