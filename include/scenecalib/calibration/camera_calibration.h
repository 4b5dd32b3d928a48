#pragma once

#include <array>
#include <functional>
#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/calibration/calibration_options.h"
#include "scenecalib/calibration/calibration_problem.h"
#include "scenecalib/geometry/trajectory.h"
#include "scenecalib/sensor/rig.h"
#include "scenecalib/tracking/track.h"

namespace scenecalib {

/// One round of the per-camera loop, for reports.
struct RoundEvidence {
  AssociationGates gates;
  std::array<int, kNumAssociationOutcomes> num_tracks_by_outcome{};
  int num_inlier_tracks = 0;
  bool from_sample = false;  ///< RANSAC found a better pose than the robust solve
  double rms_px = 0.0;       ///< over the inliers, after the solve
  double rotation_change_rad = 0.0;
  double translation_change_m = 0.0;
};

/// Where the per-camera loop ended.
struct CameraCalibration {
  CameraParameters parameters;
  double time_offset_s = 0.0;
  std::vector<RoundEvidence> rounds;
};

/// The solver's view of a camera at its initial values.
CameraParameters InitialParameters(const CameraConfig& camera);
CameraPrior InitialPrior(const CameraConfig& camera, const PriorOptions& options);

/// Ties tracks to the map and builds their whitened terms at the present parameters.
/// `num_by_outcome` may be null.
std::vector<TransferTerm> AssociateAndBuildTerms(
    const CameraContext& context, const std::vector<CameraParameters>& cameras,
    const std::vector<Track>& tracks, const RayCaster& caster, const AssociationGates& gates,
    const CalibrationOptions& options, std::array<int, kNumAssociationOutcomes>* num_by_outcome);

/// Only the terms of the tracks that are marked, in their order.
std::vector<TransferTerm> KeepTracks(const std::vector<TransferTerm>& terms,
                                     const std::vector<TrackResidual>& tracks,
                                     const std::vector<bool>& keep);

/// Gates of a round, geometric between start and end.
AssociationGates GatesOfRound(const CoarseToFineOptions& options, int round);

/// The per-camera loop (III-D): associate, RANSAC over tracks, solve, tighten, until the last
/// gates. `after_round` is called after each round; false cancels. InsufficientData names the
/// camera and says what it lacks.
Result<CameraCalibration> CalibrateCamera(const CameraConfig& camera,
                                          const std::vector<Track>& tracks,
                                          const Trajectory& map_from_lidar, const RayCaster& caster,
                                          const CalibrationOptions& options,
                                          const std::function<bool()>& after_round);

}  // namespace scenecalib
