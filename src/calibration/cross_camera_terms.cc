#include "cross_camera_terms.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "image_poses.h"
#include "scenecalib/tracking/image_quality.h"

namespace scenecalib {
namespace {

constexpr double kMinResidualSigma = 0.3;
constexpr double kMinGrazingSine = 0.02;
constexpr std::size_t kMinMatchesForSigma = 20;

/// Where the reference ray of a term meets its plane.
std::optional<Eigen::Vector3d> PointOf(const TransferTerm& term, const CameraParameters& camera,
                                       const TrajectoryCorrection& correction) {
  const auto ray = camera.model->UnprojectTuned(term.source.pixel, camera.Intrinsics(), nullptr);
  if (!ray) return std::nullopt;
  Rigid3 map_from_lidar = term.source.map_from_lidar;
  if (!correction.empty()) {
    map_from_lidar = ApplyCorrection(map_from_lidar, correction.At(term.source_place));
  }
  const Rigid3 map_from_camera = map_from_lidar * camera.LidarFromCamera();
  const Eigen::Vector3d direction = map_from_camera.rotation * *ray;
  const double sine = term.plane_normal_in_map.dot(direction);
  const double height =
      term.plane_normal_in_map.dot(term.plane_point_in_map_m - map_from_camera.translation);
  if (std::abs(sine) < kMinGrazingSine || height / sine <= 0.0) return std::nullopt;
  return Eigen::Vector3d(map_from_camera.translation + height / sine * direction);
}

/// First term of every track: the track's source view and plane.
std::map<std::pair<int, int>, const TransferTerm*> FirstTerms(
    const std::vector<TransferTerm>& terms) {
  std::map<std::pair<int, int>, const TransferTerm*> first;
  for (const TransferTerm& term : terms) {
    first.try_emplace({term.source_camera, term.track}, &term);
  }
  return first;
}

/// Divides the whitening of the terms into one camera by their own sigma, and keeps the terms whose
/// residual is then small.
std::vector<TransferTerm> NormaliseAndGate(int camera, std::vector<TransferTerm> terms,
                                           double inlier_sigmas, JointCalibration* joint) {
  JointCameraEvidence& evidence = joint->evidence[static_cast<std::size_t>(camera)];
  evidence.num_cross_camera_matches = 0;
  if (terms.size() < kMinMatchesForSigma) return {};
  evidence.cross_camera_sigma =
      std::max(kMinResidualSigma, RobustResidualSigma(joint->cameras, joint->correction, terms));
  std::vector<TransferTerm> kept;
  for (TransferTerm& term : terms) {
    term.whitening /= evidence.cross_camera_sigma;
    const std::vector<TrackResidual> residual =
        EvaluateTracks(joint->cameras, joint->correction, {term});
    if (residual[0].valid && residual[0].rms_whitened < inlier_sigmas) kept.push_back(term);
  }
  evidence.num_cross_camera_matches = static_cast<int>(kept.size());
  return kept;
}

}  // namespace

Result<MatchingCamera> PrepareForMatching(const JointCamera& camera, int index,
                                          const JointCalibration& joint,
                                          const std::vector<TransferTerm>& terms,
                                          const Trajectory& map_from_lidar,
                                          std::vector<int>* track_of) {
  const auto c = static_cast<std::size_t>(index);
  const CameraParameters& parameters = joint.cameras[c];
  MatchingCamera result;
  auto model = parameters.model->WithTunable(parameters.Intrinsics());
  if (!model.ok()) return model.status();
  result.model = *model;
  result.images = &camera.segment->images;
  result.relative_sharpness = RelativeSharpness(camera.segment->images);
  result.poses = ImagePosesOf(camera, index, joint, map_from_lidar);
  track_of->clear();
  for (const TransferTerm& term : terms) {
    if (term.source_camera != index || (!track_of->empty() && track_of->back() == term.track)) {
      continue;
    }
    const auto point = PointOf(term, parameters, joint.correction);
    if (!point) continue;
    const Track& track = joint.tracks[c][static_cast<std::size_t>(term.track)];
    if (track.observations.empty()) continue;  // dropped when it was registered again
    FeaturePoint feature;
    feature.point_in_map_m = *point;
    feature.normal_in_map = term.plane_normal_in_map;
    const TrackObservation& reference =
        track.observations[static_cast<std::size_t>(track.reference)];
    feature.reference_stamp_ns = reference.stamp_ns;
    feature.reference_px = reference.pixel;
    for (const TrackObservation& observation : track.observations) {
      feature.stamps_ns.push_back(observation.stamp_ns);
    }
    result.points.push_back(std::move(feature));
    track_of->push_back(term.track);
  }
  return result;
}

Status MatchCameras(const std::vector<JointCamera>& cameras, const Trajectory& map_from_lidar,
                    const RayCaster& caster, const std::vector<TransferTerm>& terms,
                    const CrossCameraOptions& options, JointCalibration* joint) {
  std::vector<MatchingCamera> matching;
  std::vector<std::vector<int>> track_of(cameras.size());
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    Result<MatchingCamera> camera = PrepareForMatching(cameras[c], static_cast<int>(c), *joint,
                                                       terms, map_from_lidar, &track_of[c]);
    if (!camera.ok()) return camera.status();
    matching.push_back(std::move(*camera));
  }
  joint->cross_camera = MatchAcrossCameras(matching, caster, options);
  for (CrossCameraMatch& match : joint->cross_camera.matches) {
    match.source_point = track_of[static_cast<std::size_t>(match.source_camera)]
                                 [static_cast<std::size_t>(match.source_point)];
  }
  return Status::Ok();
}

std::vector<TransferTerm> BuildCrossTerms(const std::vector<TransferTerm>& terms,
                                          const Trajectory& map_from_lidar,
                                          const CalibrationOptions& options,
                                          JointCalibration* joint) {
  const auto first = FirstTerms(terms);
  const double floor_px = options.terms.pixel_sigma_floor_px;
  std::vector<std::vector<TransferTerm>> by_target(joint->cameras.size());
  for (const CrossCameraMatch& match : joint->cross_camera.matches) {
    const auto source = first.find({match.source_camera, match.source_point});
    if (source == first.end()) continue;
    const auto target = static_cast<std::size_t>(match.target_camera);
    CameraContext context;
    context.camera = match.target_camera;
    context.parameters = &joint->cameras[target];
    context.time_offset_s = joint->time_offset_s[target];
    context.map_from_lidar = &map_from_lidar;
    context.correction = &joint->correction;
    const TrackObservation seen{match.target_stamp_ns, match.pixel, match.covariance_px2};
    const auto view = ViewAt(context, seen);
    if (!view) continue;
    TransferTerm term = *source->second;
    term.target_camera = match.target_camera;
    term.target = *view;
    term.target_covariance_px2 =
        match.covariance_px2 + floor_px * floor_px * Eigen::Matrix2d::Identity();
    term.target_stamp_ns = StampOf(context, seen);
    if (!joint->correction.empty()) {
      term.target_place = joint->correction.Locate(term.target_stamp_ns);
    }
    by_target[target].push_back(term);
  }
  std::vector<TransferTerm> cross;
  for (std::size_t target = 0; target < by_target.size(); ++target) {
    WhitenTerms(joint->cameras, joint->correction, &by_target[target]);
    const std::vector<TransferTerm> kept = NormaliseAndGate(
        static_cast<int>(target), std::move(by_target[target]), options.joint.inlier_sigmas, joint);
    cross.insert(cross.end(), kept.begin(), kept.end());
  }
  return cross;
}

}  // namespace scenecalib
