#pragma once

#include <functional>
#include <vector>

#include "scenecalib/calibration/camera_calibration.h"
#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {

/// One camera as it enters the joint solve.
struct JointCamera {
  const CameraConfig* config = nullptr;    ///< initial values, for the priors
  const CameraSegment* segment = nullptr;  ///< images for registration through the map
  std::vector<Track> tracks;               ///< those that take part
  CameraCalibration start;
};

/// How a camera fared in the joint solve.
struct JointCameraEvidence {
  std::array<int, kNumAssociationOutcomes> num_tracks_by_outcome{};
  int num_inlier_tracks = 0;
  double residual_sigma = 1.0;  ///< of its whitened residuals
  /// Matches of other cameras' points in this one's images that agree with the result.
  int num_cross_camera_matches = 0;
  double cross_camera_sigma = 1.0;  ///< of their whitened residuals
  /// True when the drive does not resolve the principal point, which then stays near its prior.
  bool intrinsics_unresolved = false;
};

/// The solution over all cameras, parallel to the input.
struct JointCalibration {
  std::vector<CameraParameters> cameras;
  /// What the cameras' models point to, where a lens has changed; else empty.
  std::vector<CameraModelPtr> models;
  std::vector<double> time_offset_s;
  TrajectoryCorrection correction;
  std::vector<JointCameraEvidence> evidence;
  std::vector<CameraStddev> stddev;
  std::vector<RadialMisfit> lenses;
  std::vector<ClockMisfit> clocks;
  std::vector<TransferTerm> terms;        ///< inliers of the last round, within one camera
  std::vector<TransferTerm> cross_terms;  ///< the same between cameras; `track` is of the source
  /// All matches between cameras as last found, of points in the order of their tracks' terms.
  CrossCameraMatching cross_camera;
  /// Each camera's tracks as last registered; the terms' `track` index into these.
  std::vector<std::vector<Track>> tracks;
  bool converged = false;
};

/// The prior of the trajectory's correction: what the mapping itself says of its relative motion,
/// else the options' rates.
CorrectionPrior CorrectionPriorOf(const SceneMap& map, const JointOptions& options);

/// Rounds of association and solve: lenses that follow the data take a few more.
int NumJointRounds(const CalibrationOptions& options);

/// Refines all cameras together with the lidar trajectory's small errors (III-F): associate,
/// optionally register the tracks again through the map (Eq. 4 within one camera), solve, repeat.
Result<JointCalibration> CalibrateJointly(const std::vector<JointCamera>& cameras,
                                          const Trajectory& map_from_lidar, const RayCaster& caster,
                                          const CorrectionPrior& correction_prior,
                                          const CalibrationOptions& options,
                                          const std::function<bool()>& after_round);

}  // namespace scenecalib
