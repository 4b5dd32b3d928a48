#include "scenecalib/calibration/rig_calibrator.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <optional>
#include <utility>

#include "scenecalib/base/log.h"
#include "scenecalib/base/random.h"
#include "scenecalib/calibration/joint_calibration.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/tracking/track_selection.h"
#include "verdicts.h"

namespace scenecalib {
namespace {

constexpr int kMinViews = 3;
constexpr std::size_t kMaxBundlesPerCamera = 150;

/// Tracks that take part in the solve and tracks that only judge it.
struct SplitTracks {
  std::vector<Track> used;
  std::vector<Track> held_out;
};

/// Seconds from the tracks' first sighting to their last.
double DurationOf(const std::vector<Track>& tracks) {
  Timestamp first_ns = std::numeric_limits<Timestamp>::max();
  Timestamp last_ns = std::numeric_limits<Timestamp>::min();
  for (const Track& track : tracks) {
    first_ns = std::min(first_ns, track.observations.front().stamp_ns);
    last_ns = std::max(last_ns, track.observations.back().stamp_ns);
  }
  return tracks.empty() ? 0.0 : SecondsBetween(first_ns, last_ns);
}

std::vector<Track> SelectJointTracks(const std::vector<Track>& tracks, const CameraModel& model,
                                     const JointOptions& options) {
  const std::size_t num_tracks =
      TrackBudget(options.max_tracks_per_camera, model, DurationOf(tracks));
  return SelectTracks(tracks, static_cast<int>(num_tracks), kMinViews, model.width_px(),
                      model.height_px());
}

SplitTracks Split(const std::vector<Track>& tracks, double held_out_share, int seed) {
  SplitTracks split;
  for (const Track& track : tracks) {
    // By id, so that a track stays on its side however many others there are.
    Random random(static_cast<std::uint64_t>(track.id) * 2654435761ULL +
                  static_cast<std::uint64_t>(seed));
    (random.Uniform() < held_out_share ? split.held_out : split.used).push_back(track);
  }
  return split;
}

/// Counts finished rounds of all cameras, whose loops run side by side.
class RoundCounter {
 public:
  RoundCounter(const ProgressCallback& callback, std::string stage, int total)
      : callback_(callback), stage_(std::move(stage)), total_(total) {}

  bool Tick() {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++done_;
    if (!cancelled_ &&
        !ReportProgress(callback_, stage_, std::min(1.0, static_cast<double>(done_) / total_))) {
      cancelled_ = true;
    }
    return !cancelled_;
  }

 private:
  const ProgressCallback& callback_;
  std::string stage_;
  int total_;
  int done_ = 0;
  bool cancelled_ = false;
  std::mutex mutex_;
};

HeldOutRms JudgeHeldOut(const std::vector<Track>& tracks, const CameraConfig& initial,
                        const JointCalibration& joint, int camera, const Trajectory& trajectory,
                        const RayCaster& caster, const CalibrationOptions& options) {
  CameraContext context;
  context.camera = camera;
  context.parameters = &joint.cameras[camera];
  context.time_offset_s = joint.time_offset_s[camera];
  context.map_from_lidar = &trajectory;
  context.correction = &joint.correction;
  const AssociationGates gates =
      GatesOfRound(options.coarse_to_fine, options.coarse_to_fine.num_rounds);
  const std::vector<TransferTerm> after_terms =
      AssociateAndBuildTerms(context, joint.cameras, tracks, caster, gates, options, nullptr);
  std::vector<CameraParameters> initial_cameras = joint.cameras;
  initial_cameras[camera] = InitialParameters(initial);
  // Both on the trajectory as it came: its correction was fitted together with the result and must
  // not speak for it.
  const std::vector<TrackResidual> after =
      EvaluateTracks(joint.cameras, TrajectoryCorrection(), after_terms);
  const std::vector<TrackResidual> before =
      EvaluateTracks(initial_cameras, TrajectoryCorrection(), after_terms);
  // Medians: a few tracks on wrong planes must not judge.
  std::vector<double> before_px;
  std::vector<double> after_px;
  for (std::size_t i = 0; i < after.size(); ++i) {
    if (!after[i].valid) continue;
    after_px.push_back(after[i].rms_px);
    before_px.push_back(before[i].valid ? before[i].rms_px
                                        : std::numeric_limits<double>::infinity());
  }
  HeldOutRms rms;
  rms.num_tracks = static_cast<int>(after_px.size());
  if (after_px.empty()) return rms;
  const auto middle = static_cast<std::ptrdiff_t>(after_px.size() / 2);
  std::nth_element(after_px.begin(), after_px.begin() + middle, after_px.end());
  std::nth_element(before_px.begin(), before_px.begin() + middle, before_px.end());
  rms.after_px = after_px[static_cast<std::size_t>(middle)];
  rms.before_px = before_px[static_cast<std::size_t>(middle)];
  return rms;
}

/// Root mean square over the inlier terms of one camera, px, at given parameters.
double InlierRms(const JointCalibration& joint, int camera,
                 const std::vector<CameraParameters>& cameras,
                 const TrajectoryCorrection& correction) {
  double sum = 0.0;
  int count = 0;
  for (const TrackResidual& track : EvaluateTracks(cameras, correction, joint.terms)) {
    if (!track.valid || joint.terms[track.first_term].target_camera != camera) continue;
    sum += track.rms_px * track.rms_px * track.num_terms;
    count += track.num_terms;
  }
  return count > 0 ? std::sqrt(sum / count) : 0.0;
}

std::vector<RayBundle> SampleBundles(int camera, const std::vector<TransferTerm>& terms,
                                     int joint_camera, const CameraParameters& parameters,
                                     const TrajectoryCorrection& correction) {
  std::vector<std::vector<const TransferTerm*>> tracks;
  for (const TransferTerm& term : terms) {
    if (term.target_camera != joint_camera) continue;
    if (tracks.empty() || tracks.back().front()->track != term.track) tracks.emplace_back();
    tracks.back().push_back(&term);
  }
  std::vector<RayBundle> bundles;
  const Rigid3 lidar_from_camera = parameters.LidarFromCamera();
  const std::size_t stride = std::max<std::size_t>(1, tracks.size() / kMaxBundlesPerCamera);
  for (std::size_t i = 0; i < tracks.size(); i += stride) {
    RayBundle bundle;
    bundle.camera = camera;
    const auto add = [&](const TransferView& view, const TrajectoryCorrection::Place& place) {
      const auto ray =
          parameters.model->UnprojectTuned(view.pixel, parameters.Intrinsics(), nullptr);
      if (!ray) return;
      const Rigid3 map_from_camera =
          ApplyCorrection(view.map_from_lidar, correction.At(place)) * lidar_from_camera;
      const Eigen::Vector3d direction = map_from_camera.rotation * *ray;
      const Eigen::Vector3d& normal = tracks[i].front()->plane_normal_in_map;
      const double range =
          normal.dot(tracks[i].front()->plane_point_in_map_m - map_from_camera.translation) /
          normal.dot(direction);
      if (!(range > 0.0) || range > 1e3) return;
      bundle.origins_in_map_m.push_back(map_from_camera.translation);
      bundle.points_in_map_m.push_back(map_from_camera.translation + range * direction);
    };
    add(tracks[i].front()->source, tracks[i].front()->source_place);
    for (const TransferTerm* term : tracks[i]) add(term->target, term->target_place);
    bundles.push_back(std::move(bundle));
  }
  return bundles;
}

/// Everything between the per-camera loops and the verdicts of the cameras that got that far.
class Finisher {
 public:
  Finisher(const Rig& initial, const SceneMap& map, const RayCaster& caster,
           const CalibrationOptions& options, RigCalibration* calibration)
      : initial_(initial),
        map_(map),
        caster_(caster),
        options_(options),
        calibration_(calibration) {}

  void Finish(const JointCalibration& joint, int joint_camera, int camera,
              const std::vector<Track>& held_out_tracks) const {
    const CameraConfig& config = initial_.cameras[camera];
    CameraQuality& quality = calibration_->result.cameras[camera];
    quality.num_inlier_tracks = joint.evidence[joint_camera].num_inlier_tracks;
    quality.num_cross_camera_matches = joint.evidence[joint_camera].num_cross_camera_matches;
    quality.stddev = joint.stddev[joint_camera];
    std::vector<CameraParameters> initial_cameras = joint.cameras;
    initial_cameras[joint_camera] = InitialParameters(config);
    const TrajectoryCorrection none;
    quality.rms_before_px = InlierRms(joint, joint_camera, initial_cameras, none);
    quality.rms_after_px = InlierRms(joint, joint_camera, joint.cameras, joint.correction);
    const HeldOutRms held_out = JudgeHeldOut(held_out_tracks, config, joint, joint_camera,
                                             map_.map_from_lidar, caster_, options_);
    CameraEvidence& evidence = calibration_->evidence.cameras[camera];
    evidence.num_tracks_by_outcome = joint.evidence[joint_camera].num_tracks_by_outcome;
    evidence.num_held_out_tracks = held_out.num_tracks;
    evidence.held_out_before_px = held_out.before_px;
    evidence.held_out_after_px = held_out.after_px;
    evidence.residuals = SampleResiduals(joint, joint_camera);
    const CameraParameters& parameters = joint.cameras[joint_camera];
    const Rigid3 result = parameters.LidarFromCamera();
    quality.reasons = Objections(config, quality, joint.evidence[joint_camera], held_out, result,
                                 options_.acceptance);
    const auto model = parameters.model->WithTunable(parameters.Intrinsics());
    if (!model.ok()) quality.reasons.push_back(model.status().message());
    const ClockMisfit& clock = joint.clocks[joint_camera];
    const MisfitVerdict misfits[] = {
        JudgeShutter(clock, config), JudgeTimeOffset(clock, config),
        options_.estimate_distortion ? MisfitVerdict() : JudgeLens(joint.lenses[joint_camera])};
    for (const MisfitVerdict& verdict : misfits) {
      if (verdict.is_bad) quality.reasons.push_back(verdict.text);
    }
    quality.accepted = quality.reasons.empty();
    if (quality.accepted) {
      CameraConfig& refined = calibration_->result.rig.cameras[camera];
      refined.lidar_from_camera = result;
      refined.time_offset_s = joint.time_offset_s[joint_camera];
      if (!options_.hold_intrinsics || options_.estimate_distortion) refined.model = *model;
      quality.reasons = WeakDirections(quality.stddev, options_.acceptance);
      if (joint.evidence[joint_camera].intrinsics_unresolved) {
        quality.reasons.push_back(
            "principal point stays near its initial value: this drive does not tell it from the "
            "rotation; drive curves to refine it");
      }
      for (const MisfitVerdict& verdict : misfits) {
        if (!verdict.text.empty()) quality.reasons.push_back(verdict.text);
      }
    }
    Append(SampleBundles(camera, joint.terms, joint_camera, initial_cameras[joint_camera], none),
           &calibration_->bundles_before);
    Append(SampleBundles(camera, joint.terms, joint_camera, parameters, joint.correction),
           &calibration_->bundles_after);
  }

 private:
  static void Append(std::vector<RayBundle> more, std::vector<RayBundle>* bundles) {
    std::move(more.begin(), more.end(), std::back_inserter(*bundles));
  }

  const Rig& initial_;
  const SceneMap& map_;
  const RayCaster& caster_;
  const CalibrationOptions& options_;
  RigCalibration* calibration_;
};

}  // namespace

Result<RigCalibration> CalibrateRig(const Rig& initial, const SceneMap& map,
                                    const std::vector<CameraSegment>& segments,
                                    const CalibrationOptions& options,
                                    const ProgressCallback& progress) {
  const Result<RayCaster> surfaces = RayCaster::Create(map);
  if (!surfaces.ok()) return surfaces.status();
  return CalibrateRig(initial, map, *surfaces, segments, options, progress);
}

Result<RigCalibration> CalibrateRig(const Rig& initial, const SceneMap& map,
                                    const RayCaster& surfaces,
                                    const std::vector<CameraSegment>& segments,
                                    const CalibrationOptions& options,
                                    const ProgressCallback& progress,
                                    const WorkBeside& beside_joint) {
  if (segments.size() != initial.cameras.size()) {
    return Status::InvalidArgument("there must be one segment of tracks per camera");
  }
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  const int num_cameras = static_cast<int>(initial.cameras.size());
  RigCalibration calibration;
  calibration.result.rig = initial;
  calibration.result.cameras.resize(num_cameras);
  std::vector<SplitTracks> tracks(num_cameras);
  std::vector<std::optional<Result<CameraCalibration>>> loops(num_cameras);
  RoundCounter loop_rounds(progress, "calibration: cameras",
                           num_cameras * options.coarse_to_fine.num_rounds);
  tbb::parallel_for(0, num_cameras, [&](int c) {
    const CameraConfig& camera = initial.cameras[c];
    tracks[c] = Split(segments[c].tracks, options.acceptance.held_out_share, options.seed);
    calibration.result.cameras[c].num_tracks = static_cast<int>(segments[c].tracks.size());
    loops[c] = CalibrateCamera(camera, tracks[c].used, map.map_from_lidar, surfaces, options,
                               [&loop_rounds] { return loop_rounds.Tick(); });
  });

  std::vector<JointCamera> joint_cameras;
  std::vector<int> camera_of_joint;
  for (int c = 0; c < num_cameras; ++c) {
    const Result<CameraCalibration>& loop = *loops[c];
    if (!loop.ok()) {
      if (loop.status().code() == Status::Code::kCancelled) return loop.status();
      calibration.result.cameras[c].reasons.push_back(loop.status().message());
      continue;
    }
    JointCamera camera;
    camera.config = &initial.cameras[c];
    camera.segment = &segments[c];
    camera.tracks = SelectJointTracks(tracks[c].used, *initial.cameras[c].model, options.joint);
    camera.start = *loop;
    joint_cameras.push_back(std::move(camera));
    camera_of_joint.push_back(c);
  }
  if (joint_cameras.empty()) {
    std::string reasons;
    for (const CameraQuality& quality : calibration.result.cameras) {
      for (const std::string& reason : quality.reasons) reasons += "; " + reason;
    }
    return Status::InsufficientData("no camera could be calibrated" + reasons);
  }

  RoundCounter joint_rounds(progress, "calibration: joint", NumJointRounds(options));
  Result<JointCalibration> joint = Status::Cancelled("not begun");
  std::atomic<bool> failed{false};
  tbb::parallel_invoke(
      [&] {
        joint = CalibrateJointly(joint_cameras, map.map_from_lidar, surfaces,
                                 CorrectionPriorOf(map, options.joint), options,
                                 [&joint_rounds] { return joint_rounds.Tick(); });
        failed = !joint.ok();
      },
      [&] {
        if (beside_joint) beside_joint(failed);
      });
  if (!joint.ok()) return joint.status();
  calibration.evidence.cameras.resize(num_cameras);
  for (int c = 0; c < num_cameras; ++c) {
    if (loops[c]->ok()) calibration.evidence.cameras[c].rounds = (*loops[c])->rounds;
  }
  AddCrossCameraEvidence(initial, *joint, camera_of_joint, &calibration.evidence);
  const Finisher finisher(initial, map, surfaces, options, &calibration);
  for (std::size_t j = 0; j < joint_cameras.size(); ++j) {
    finisher.Finish(*joint, static_cast<int>(j), camera_of_joint[j],
                    tracks[camera_of_joint[j]].held_out);
  }
  calibration.result.accepted = true;
  for (int c = 0; c < num_cameras; ++c) {
    if (calibration.result.cameras[c].accepted) continue;
    calibration.result.accepted = false;
    calibration.result.reasons.push_back(initial.cameras[c].name + " was not accepted");
  }
  return calibration;
}

}  // namespace scenecalib
