#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "scenecalib/association/track_association.h"
#include "scenecalib/calibration/camera_calibration.h"
#include "scenecalib/calibration/joint_calibration.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// One transfer of the last solve as a picture of the residuals needs it.
struct ResidualSample {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();        ///< where the camera saw the point
  Eigen::Vector2d residual_px = Eigen::Vector2d::Zero();  ///< predicted minus seen
  double range_m = 0.0;                                   ///< of the point from the camera
  SurfaceKind surface = SurfaceKind::kGround;
};

/// How one camera's calibration went; empty where it did not get that far.
struct CameraEvidence {
  std::vector<RoundEvidence> rounds;  ///< of the per-camera loop
  /// Fate of the tracks of the joint solve's last round.
  std::array<int, kNumAssociationOutcomes> num_tracks_by_outcome{};
  int num_held_out_tracks = 0;
  double held_out_before_px = 0.0;  ///< median of the tracks' RMS, initial values
  double held_out_after_px = 0.0;
  std::vector<ResidualSample> residuals;  ///< a bounded sample, evenly over the terms
};

/// Agreement of two cameras over the matches of one's points in the other's images.
struct CrossCameraEvidence {
  int source_camera = 0;  ///< index into the rig
  int target_camera = 0;
  int num_matches = 0;            ///< used by the last solve
  double median_before_px = 0.0;  ///< between match and prediction, initial values
  double median_after_px = 0.0;
};

/// One match between two cameras, as found: a track's pixel in its reference view and where the
/// other camera sees the same point. Stamps are of the cameras' own clocks.
struct MatchedPixels {
  int source_camera = 0;  ///< index into the rig
  int target_camera = 0;
  Timestamp source_stamp_ns = 0;
  Timestamp target_stamp_ns = 0;
  Eigen::Vector2d source_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d target_px = Eigen::Vector2d::Zero();
};

/// What CalibrateRig saw on its way, for reports.
struct CalibrationEvidence {
  std::vector<CameraEvidence> cameras;     ///< parallel to the rig's cameras
  std::vector<CrossCameraEvidence> pairs;  ///< by source, then target; only pairs with matches
  /// Candidates between cameras and why they were dropped, as last matched (its `matches` are
  /// below).
  CrossCameraMatching cross_camera;
  std::vector<MatchedPixels> matches;  ///< the same, before any is rejected by its residual
  bool joint_converged = false;
  double correction_rms_m = 0.0;  ///< of the trajectory's correction
  double correction_rms_rad = 0.0;
};

/// The residuals of one camera's own terms after the joint solve.
std::vector<ResidualSample> SampleResiduals(const JointCalibration& joint, int joint_camera);

/// Fills everything that concerns more than one camera. `camera_of_joint` maps the joint solve's
/// cameras to the rig's.
void AddCrossCameraEvidence(const Rig& initial, const JointCalibration& joint,
                            const std::vector<int>& camera_of_joint, CalibrationEvidence* evidence);

}  // namespace scenecalib
