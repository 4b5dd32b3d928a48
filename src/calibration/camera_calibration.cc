#include "scenecalib/calibration/camera_calibration.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kRadPerDeg = 0.017453292519943295;
constexpr int kMinViews = 3;
/// No fewer tracks than this can carry a round, whatever the options say.
constexpr int kMinTracksOfRound = 15;
/// The residual's sigma is not believed below this share of what the covariances promise.
constexpr double kMinResidualSigma = 0.3;

double RmsPx(const std::vector<TrackResidual>& tracks) {
  double sum = 0.0;
  int count = 0;
  for (const TrackResidual& track : tracks) {
    if (!track.valid) continue;
    sum += track.rms_px * track.rms_px * track.num_terms;
    count += track.num_terms;
  }
  return count > 0 ? std::sqrt(sum / count) : 0.0;
}

void EstimateSigma(CalibrationProblem* problem) {
  problem->residual_sigma =
      std::max(kMinResidualSigma,
               RobustResidualSigma(*problem->cameras, *problem->correction, problem->terms));
}

/// Rotation first, then translation: the order that recovers from far away. The intrinsics wait for
/// the joint solve: with the trajectory held fixed, the principal point would take up its errors.
FreeParameters FreeInRound(int round) {
  FreeParameters free;
  free.translation = round > 0;
  return free;
}

std::string DescribeOutcomes(const std::array<int, kNumAssociationOutcomes>& counts) {
  std::string text;
  for (int i = 1; i < kNumAssociationOutcomes; ++i) {
    if (counts[i] == 0) continue;
    if (!text.empty()) text += ", ";
    text += std::to_string(counts[i]) + " " + ToString(static_cast<AssociationOutcome>(i));
  }
  return text.empty() ? "none rejected" : text;
}

}  // namespace

CameraParameters InitialParameters(const CameraConfig& camera) {
  CameraParameters parameters;
  parameters.model = camera.model.get();
  parameters.base_lidar_from_camera = camera.lidar_from_camera;
  const TunableIntrinsics& tunable = camera.model->tunable();
  parameters.intrinsics << tunable.focal_scale, tunable.principal_point_px;
  parameters.rolling_shutter_line_time_s = camera.rolling_shutter_line_time_s.value_or(0.0);
  return parameters;
}

CameraPrior InitialPrior(const CameraConfig& camera, const PriorOptions& options) {
  CameraPrior prior;
  prior.initial_lidar_from_camera = camera.lidar_from_camera;
  const TunableIntrinsics& tunable = camera.model->tunable();
  prior.initial_intrinsics << tunable.focal_scale, tunable.principal_point_px;
  const InitialStddev& stated = camera.initial_stddev;
  prior.rotation_rad =
      stated.rotation_rad.value_or(Eigen::Vector3d::Constant(options.rotation_deg * kRadPerDeg));
  prior.translation_m =
      stated.translation_m.value_or(Eigen::Vector3d::Constant(options.translation_m));
  prior.focal_scale = stated.focal_scale.value_or(options.focal_scale);
  prior.principal_point_px = stated.principal_point_px.value_or(
      Eigen::Vector2d::Constant(options.principal_point_share * camera.model->width_px()));
  prior.time_offset_s = stated.time_offset_s.value_or(options.time_offset_s);
  prior.initial_time_offset_s = camera.time_offset_s;
  return prior;
}

AssociationGates GatesOfRound(const CoarseToFineOptions& options, int round) {
  const double fraction =
      std::min(1.0, static_cast<double>(round) / std::max(1, options.num_rounds - 2));
  const auto between = [fraction](double start, double end) {
    return start * std::pow(end / start, fraction);
  };
  AssociationGates gates;
  gates.sigma_theta_rad =
      kRadPerDeg * between(options.sigma_theta_start_deg, options.sigma_theta_end_deg);
  gates.sigma_d_m = between(options.sigma_d_start_m, options.sigma_d_end_m);
  return gates;
}

std::vector<TransferTerm> AssociateAndBuildTerms(
    const CameraContext& context, const std::vector<CameraParameters>& cameras,
    const std::vector<Track>& tracks, const RayCaster& caster, const AssociationGates& gates,
    const CalibrationOptions& options, std::array<int, kNumAssociationOutcomes>* num_by_outcome) {
  const std::vector<TrackAssociation> associations =
      AssociateTracks(BuildBundles(context, tracks), caster, gates, options.association);
  if (num_by_outcome != nullptr) {
    num_by_outcome->fill(0);
    for (std::size_t i = 0; i < tracks.size(); ++i) {
      // Registration through the map leaves nothing of the tracks that it drops.
      const AssociationOutcome outcome = tracks[i].observations.empty()
                                             ? AssociationOutcome::kNotAsPredicted
                                             : associations[i].outcome;
      ++(*num_by_outcome)[static_cast<std::size_t>(outcome)];
    }
  }
  std::vector<TransferTerm> terms = BuildTerms(context, tracks, associations, options.terms);
  WhitenTerms(cameras, *context.correction, &terms);
  return terms;
}

std::vector<TransferTerm> KeepTracks(const std::vector<TransferTerm>& terms,
                                     const std::vector<TrackResidual>& tracks,
                                     const std::vector<bool>& keep) {
  std::vector<TransferTerm> kept;
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    if (!keep[i]) continue;
    const auto first = terms.begin() + tracks[i].first_term;
    kept.insert(kept.end(), first, first + tracks[i].num_terms);
  }
  return kept;
}

Result<CameraCalibration> CalibrateCamera(const CameraConfig& camera,
                                          const std::vector<Track>& all_tracks,
                                          const Trajectory& map_from_lidar, const RayCaster& caster,
                                          const CalibrationOptions& options,
                                          const std::function<bool()>& after_round) {
  const std::vector<Track> tracks =
      SelectTracks(all_tracks, options.coarse_to_fine.max_tracks, kMinViews,
                   camera.model->width_px(), camera.model->height_px());
  if (static_cast<int>(tracks.size()) < kMinTracksOfRound) {
    return Status::InsufficientData(
        camera.name + ": only " + std::to_string(tracks.size()) +
        " feature tracks; look whether its images show the surroundings, or drive further");
  }
  std::vector<CameraParameters> cameras{InitialParameters(camera)};
  TrajectoryCorrection no_correction;
  CameraCalibration calibration;
  calibration.time_offset_s = camera.time_offset_s;
  const int num_rounds = options.coarse_to_fine.num_rounds;
  for (int round = 0; round < num_rounds; ++round) {
    CameraContext context;
    context.parameters = &cameras[0];
    context.time_offset_s = camera.time_offset_s;
    context.map_from_lidar = &map_from_lidar;
    context.correction = &no_correction;
    RoundEvidence evidence;
    evidence.gates = GatesOfRound(options.coarse_to_fine, round);

    CalibrationProblem problem;
    problem.cameras = &cameras;
    problem.priors = {InitialPrior(camera, options.prior)};
    problem.time_offset_s = {camera.time_offset_s};
    problem.correction = &no_correction;
    problem.free = FreeInRound(round);
    problem.terms = AssociateAndBuildTerms(context, cameras, tracks, caster, evidence.gates,
                                           options, &evidence.num_tracks_by_outcome);
    if (evidence.num_tracks_by_outcome[0] < kMinTracksOfRound) {
      return Status::InsufficientData(
          camera.name + ": only " + std::to_string(evidence.num_tracks_by_outcome[0]) + " of " +
          std::to_string(tracks.size()) + " tracks meet the map (" +
          DescribeOutcomes(evidence.num_tracks_by_outcome) +
          "); check its initial pose and that the lidar sees what it sees");
    }
    EstimateSigma(&problem);
    const Rigid3 before = cameras[0].LidarFromCamera();
    problem.function_tolerance = CalibrationProblem::kRoughTolerance;
    Result<SolveEvidence> robust = problem.Solve();
    if (!robust.ok())
      return Status::NumericalFailure(camera.name + ": " + robust.status().message());
    EstimateSigma(&problem);

    const TrackRansacResult ransac =
        RansacTracks(problem, 0, options.ransac, static_cast<std::uint64_t>(options.seed) + round);
    const std::vector<TrackResidual> residuals =
        EvaluateTracks(cameras, no_correction, problem.terms);
    cameras[0] = ransac.camera;
    problem.terms = KeepTracks(problem.terms, residuals, ransac.is_inlier);
    evidence.num_inlier_tracks = ransac.num_inliers;
    evidence.from_sample = ransac.from_sample;
    if (ransac.num_inliers >= kMinTracksOfRound) {
      EstimateSigma(&problem);
      if (round + 1 == num_rounds) {
        problem.function_tolerance = CalibrationProblem::kFinalTolerance;
      }
      const Result<SolveEvidence> refined = problem.Solve();
      if (!refined.ok()) {
        return Status::NumericalFailure(camera.name + ": " + refined.status().message());
      }
    }
    evidence.rms_px = RmsPx(EvaluateTracks(cameras, no_correction, problem.terms));
    const Rigid3 after = cameras[0].LidarFromCamera();
    evidence.rotation_change_rad = RotationAngle(before.rotation, after.rotation);
    evidence.translation_change_m = (after.translation - before.translation).norm();
    cameras[0].Rebase();
    calibration.rounds.push_back(evidence);
    if (after_round && !after_round()) return Status::Cancelled("calibration cancelled");
  }
  calibration.parameters = cameras[0];
  return calibration;
}

}  // namespace scenecalib
