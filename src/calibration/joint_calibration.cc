#include "scenecalib/calibration/joint_calibration.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "cross_camera_terms.h"
#include "image_poses.h"
#include "patch_support.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/sensor/lens_shape.h"
#include "scenecalib/tracking/map_guided_registration.h"

namespace scenecalib {
namespace {

constexpr double kRadPerDeg = 0.017453292519943295;
constexpr double kMinResidualSigma = 0.3;
/// A principal point that is not known better than this share of its prior was not shown.
constexpr double kUnresolvedShare = 0.5;
/// Further rounds of lenses that follow the data, one Newton step each.
constexpr int kRoundsForLenses = 2;
/// The first round that frees the intrinsics. What it finds is still on its way where they trade
/// with the rotation: patches are registered and matched again only by what the next one finds.
constexpr int kFreeingRound = 1;

CameraContext ContextOf(const JointCalibration& joint, int camera, const Trajectory& trajectory) {
  CameraContext context;
  context.camera = camera;
  context.parameters = &joint.cameras[camera];
  context.time_offset_s = joint.time_offset_s[camera];
  context.map_from_lidar = &trajectory;
  context.correction = &joint.correction;
  return context;
}

/// Divides each camera's whitening by its own robust sigma, so that one unit is one sigma for all.
void NormaliseByCamera(const JointCalibration& joint, std::vector<TransferTerm>* terms,
                       JointCameraEvidence* evidence) {
  evidence->residual_sigma =
      std::max(kMinResidualSigma, RobustResidualSigma(joint.cameras, joint.correction, *terms));
  for (TransferTerm& term : *terms) term.whitening /= evidence->residual_sigma;
}

/// Terms of one camera at the present solution: associated, whitened, normalised, gated. Of the
/// joint solution only that camera's evidence changes.
std::vector<TransferTerm> CollectTerms(JointCalibration* joint, int camera,
                                       const Trajectory& trajectory, const RayCaster& caster,
                                       const CalibrationOptions& options) {
  JointCameraEvidence& evidence = joint->evidence[camera];
  const AssociationGates gates =
      GatesOfRound(options.coarse_to_fine, options.coarse_to_fine.num_rounds);
  std::vector<TransferTerm> terms = AssociateAndBuildTerms(
      ContextOf(*joint, camera, trajectory), joint->cameras, joint->tracks[camera], caster, gates,
      options, &evidence.num_tracks_by_outcome);
  NormaliseByCamera(*joint, &terms, &evidence);
  const std::vector<TrackResidual> tracks =
      EvaluateTracks(joint->cameras, joint->correction, terms);
  std::vector<bool> keep;
  evidence.num_inlier_tracks = 0;
  for (const TrackResidual& track : tracks) {
    keep.push_back(track.valid && track.rms_whitened < options.joint.inlier_sigmas);
    if (keep.back()) ++evidence.num_inlier_tracks;
  }
  return KeepTracks(terms, tracks, keep);
}

CalibrationProblem MakeProblem(JointCalibration* joint, const std::vector<JointCamera>& cameras,
                               const CorrectionPrior& correction_prior,
                               const CalibrationOptions& options) {
  CalibrationProblem problem;
  problem.cameras = &joint->cameras;
  problem.correction = &joint->correction;
  problem.time_offset_s = joint->time_offset_s;
  for (const JointCamera& camera : cameras) {
    problem.priors.push_back(InitialPrior(*camera.config, options.prior));
  }
  problem.free.time_offset = options.estimate_time_offset;
  problem.free.correction = options.joint.correct_trajectory;
  problem.correction_prior = correction_prior;
  problem.intrinsics_prior_weight = options.prior.formal_optimism;
  problem.lenses_follow = options.estimate_distortion;
  return problem;
}

void FoldDeltas(JointCalibration* joint) {
  for (std::size_t c = 0; c < joint->cameras.size(); ++c) {
    joint->cameras[c].Rebase();
    joint->time_offset_s[c] += joint->cameras[c].time_offset_delta_s;
    joint->cameras[c].time_offset_delta_s = 0.0;
  }
}

/// Whether the drive showed the intrinsics better than their priors say.
void JudgeIntrinsics(const CalibrationProblem& problem, JointCalibration* joint) {
  for (std::size_t c = 0; c < joint->cameras.size(); ++c) {
    joint->evidence[c].intrinsics_unresolved =
        (joint->stddev[c].principal_point_px.array() >
         kUnresolvedShare * problem.priors[c].principal_point_px.array())
            .any();
  }
}

/// Gives the cameras the lenses that the data asks for, at a solution of the problem.
Status ChangeLenses(const CalibrationProblem& problem, JointCalibration* joint) {
  Result<CalibrationUncertainty> uncertainty = problem.EstimateUncertainty();
  if (!uncertainty.ok()) return uncertainty.status();
  for (std::size_t c = 0; c < joint->cameras.size(); ++c) {
    Result<CameraModelPtr> changed =
        WithRadialChange(*joint->cameras[c].model, uncertainty->lenses[c].change);
    if (!changed.ok()) continue;  // it would fold: better the lens as it is
    joint->models[c] = std::move(*changed);
    joint->cameras[c].model = joint->models[c].get();
  }
  return Status::Ok();
}

/// Registers the inlier tracks of one camera again, now that their planes, the trajectory and a
/// calibration are known, and drops those at the edge of a plane. Tracks without a plane stay as
/// they are, and all else of the joint solution.
Status RegisterAgain(const JointCamera& camera, int index, const std::vector<TransferTerm>& terms,
                     const Trajectory& trajectory, const RayCaster& caster,
                     const CalibrationOptions& options, JointCalibration* joint) {
  const CameraParameters& parameters = joint->cameras[index];
  const auto model = parameters.model->WithTunable(parameters.Intrinsics());
  if (!model.ok()) return model.status();
  const std::map<Timestamp, ImagePose> poses = ImagePosesOf(camera, index, *joint, trajectory);
  std::vector<Track>& tracks = joint->tracks[index];
  std::vector<int> candidates;
  std::vector<PatchOnSurface> patches;
  for (const TransferTerm& term : terms) {
    if (term.target_camera != index || (!candidates.empty() && candidates.back() == term.track)) {
      continue;
    }
    const Track& track = tracks[term.track];
    const TrackObservation& reference = track.observations[track.reference];
    const auto pose = poses.find(reference.stamp_ns);
    if (pose == poses.end()) continue;
    candidates.push_back(term.track);
    patches.push_back({reference.pixel,
                       pose->second.At(reference.pixel.y()),
                       {term.plane_point_in_map_m, term.plane_normal_in_map}});
  }
  const TiedTracks tied = DropTracksAtEdges(candidates, patches, **model, caster,
                                            options.map_guided.radius_px, &tracks);
  MapGuidedTracks registered = RegisterThroughMap(tied.tracks, tied.planes, **model, poses,
                                                  camera.segment->images, options.map_guided);
  for (std::size_t i = 0; i < tied.indices.size(); ++i) {
    tracks[tied.indices[i]] = std::move(registered.tracks[i]);
  }
  return Status::Ok();
}

}  // namespace

CorrectionPrior CorrectionPriorOf(const SceneMap& map, const JointOptions& options) {
  CorrectionPrior prior;
  prior.walk_rotation_rad = kRadPerDeg * options.correction_walk_rotation_deg;
  prior.walk_translation_m = options.correction_walk_translation_m;
  prior.frame_rotation_rad = map.lidar_frame.rotation_rad;
  prior.frame_translation_m = map.lidar_frame.translation_m;
  // Of a random walk, the error over one second is the rate itself.
  const RelativeMotionSigma* nearest = nullptr;
  for (const RelativeMotionSigma& sigma : map.relative_motion) {
    if (nearest == nullptr ||
        std::abs(std::log(sigma.window_s)) < std::abs(std::log(nearest->window_s))) {
      nearest = &sigma;
    }
  }
  if (nearest == nullptr) return prior;
  const double root_s = std::sqrt(nearest->window_s);
  prior.walk_rotation_rad = std::max(kRadPerDeg * options.min_correction_walk_rotation_deg,
                                     nearest->rotation_rad / root_s);
  prior.walk_translation_m =
      std::max(options.min_correction_walk_translation_m, nearest->translation_m / root_s);
  return prior;
}

int NumJointRounds(const CalibrationOptions& options) {
  return options.joint.num_rounds + (options.estimate_distortion ? kRoundsForLenses : 0);
}

Result<JointCalibration> CalibrateJointly(const std::vector<JointCamera>& cameras,
                                          const Trajectory& map_from_lidar, const RayCaster& caster,
                                          const CorrectionPrior& correction_prior,
                                          const CalibrationOptions& options,
                                          const std::function<bool()>& after_round) {
  JointCalibration joint;
  joint.correction = TrajectoryCorrection(map_from_lidar.start_ns(), map_from_lidar.end_ns(),
                                          options.joint.correction_knot_s);
  for (const JointCamera& camera : cameras) {
    joint.cameras.push_back(camera.start.parameters);
    joint.time_offset_s.push_back(camera.start.time_offset_s);
    joint.tracks.push_back(camera.tracks);
  }
  joint.models.resize(cameras.size());
  joint.evidence.resize(cameras.size());
  CalibrationProblem problem = MakeProblem(&joint, cameras, correction_prior, options);
  const int num_rounds = NumJointRounds(options);
  for (int round = 0; round < num_rounds; ++round) {
    const bool is_last = round + 1 == num_rounds;
    const bool looks_again = !is_last && (round != kFreeingRound || round + 2 == num_rounds);
    joint.terms.clear();
    problem.time_offset_s = joint.time_offset_s;
    problem.free.intrinsics =
        !options.hold_intrinsics && round >= kFreeingRound;  // not until the poses are good
    std::vector<std::vector<TransferTerm>> terms(cameras.size());
    tbb::parallel_for(std::size_t{0}, cameras.size(), [&](std::size_t c) {
      terms[c] = CollectTerms(&joint, static_cast<int>(c), map_from_lidar, caster, options);
    });
    for (const auto& of_camera : terms) {
      joint.terms.insert(joint.terms.end(), of_camera.begin(), of_camera.end());
    }
    joint.cross_terms = BuildCrossTerms(joint.terms, map_from_lidar, options, &joint);
    problem.terms = joint.terms;
    problem.terms.insert(problem.terms.end(), joint.cross_terms.begin(), joint.cross_terms.end());
    problem.function_tolerance =
        is_last ? CalibrationProblem::kFinalTolerance : CalibrationProblem::kRoughTolerance;
    const Result<SolveEvidence> solved = problem.Solve();
    if (!solved.ok()) return solved.status();
    joint.converged = solved->converged;
    if (is_last) {
      Result<CalibrationUncertainty> uncertainty = problem.EstimateUncertainty();
      if (!uncertainty.ok()) return uncertainty.status();
      joint.stddev = std::move(uncertainty->stddev);
      joint.lenses = std::move(uncertainty->lenses);
      joint.clocks = std::move(uncertainty->clocks);
      if (!options.hold_intrinsics) JudgeIntrinsics(problem, &joint);
    }
    if (options.estimate_distortion && round > 0 && !is_last) {
      SCENECALIB_RETURN_IF_ERROR(ChangeLenses(problem, &joint));
    }
    FoldDeltas(&joint);
    if (options.joint.register_through_map && looks_again) {
      std::vector<Status> registered(cameras.size(), Status::Ok());
      tbb::parallel_for(std::size_t{0}, cameras.size(), [&](std::size_t c) {
        registered[c] = RegisterAgain(cameras[c], static_cast<int>(c), joint.terms, map_from_lidar,
                                      caster, options, &joint);
      });
      for (const Status& status : registered) SCENECALIB_RETURN_IF_ERROR(status);
    }
    if (looks_again) {
      CrossCameraOptions matching = options.cross_camera;
      if (round > 0) matching.search_px = std::min(matching.search_px, matching.search_again_px);
      SCENECALIB_RETURN_IF_ERROR(
          MatchCameras(cameras, map_from_lidar, caster, joint.terms, matching, &joint));
    }
    if (after_round && !after_round()) return Status::Cancelled("calibration cancelled");
  }
  return joint;
}

}  // namespace scenecalib
