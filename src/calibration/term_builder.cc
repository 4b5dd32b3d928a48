#include "scenecalib/calibration/term_builder.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "scenecalib/geometry/so3.h"
#include "scenecalib/tracking/track_selection.h"

namespace scenecalib {
namespace {

constexpr double kTwistStep_s = 0.01;

/// Body twist (rotation, then translation; lidar frame) by central differences; zero at the ends.
Vector6d TwistAt(const Trajectory& trajectory, Timestamp stamp_ns) {
  Vector6d twist = Vector6d::Zero();
  const auto before = trajectory.Interpolate(AddSeconds(stamp_ns, -kTwistStep_s));
  const auto after = trajectory.Interpolate(AddSeconds(stamp_ns, kTwistStep_s));
  const auto now = trajectory.Interpolate(stamp_ns);
  if (!before || !after || !now) return twist;
  twist.head<3>() = LogSo3(before->rotation.conjugate() * after->rotation) / (2.0 * kTwistStep_s);
  twist.tail<3>() =
      now->rotation.conjugate() * (after->translation - before->translation) / (2.0 * kTwistStep_s);
  return twist;
}

/// Indices of at most `count` of n items, evenly spread, always including `keep`.
std::vector<int> Spread(int n, int count, int keep) {
  std::vector<int> indices;
  if (n <= count) {
    for (int i = 0; i < n; ++i) indices.push_back(i);
    return indices;
  }
  for (int i = 0; i < count; ++i) {
    indices.push_back(static_cast<int>(std::lround(i * (n - 1.0) / (count - 1.0))));
  }
  if (!std::binary_search(indices.begin(), indices.end(), keep)) {
    auto nearest = std::lower_bound(indices.begin(), indices.end(), keep);
    if (nearest == indices.end()) --nearest;
    *nearest = keep;
  }
  return indices;
}

}  // namespace

Timestamp StampOf(const CameraContext& context, const TrackObservation& observation) {
  return AddSeconds(observation.stamp_ns,
                    context.time_offset_s +
                        context.parameters->rolling_shutter_line_time_s * observation.pixel.y());
}

std::optional<TransferView> ViewAt(const CameraContext& context,
                                   const TrackObservation& observation) {
  const Timestamp stamp_ns = StampOf(context, observation);
  const auto map_from_lidar = context.map_from_lidar->Interpolate(stamp_ns);
  if (!map_from_lidar) return std::nullopt;
  TransferView view;
  view.pixel = observation.pixel;
  view.map_from_lidar = *map_from_lidar;
  view.twist_in_lidar = TwistAt(*context.map_from_lidar, stamp_ns);
  return view;
}

std::vector<std::vector<Ray>> BuildBundles(const CameraContext& context,
                                           const std::vector<Track>& tracks) {
  const CameraParameters& camera = *context.parameters;
  const Rigid3 lidar_from_camera = camera.LidarFromCamera();
  // Poses repeat: every image is seen by hundreds of tracks.
  std::map<Timestamp, std::optional<Rigid3>> map_from_camera;
  std::vector<std::vector<Ray>> bundles(tracks.size());
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    for (const TrackObservation& observation : tracks[i].observations) {
      const Timestamp stamp_ns = StampOf(context, observation);
      auto [entry, inserted] = map_from_camera.try_emplace(stamp_ns);
      if (inserted) {
        const auto pose = context.map_from_lidar->Interpolate(stamp_ns);
        if (pose) entry->second = context.correction->Apply(*pose, stamp_ns) * lidar_from_camera;
      }
      if (!entry->second) continue;
      const auto ray =
          camera.model->UnprojectTuned(observation.pixel, camera.Intrinsics(), nullptr);
      if (!ray) continue;
      bundles[i].push_back({entry->second->translation, entry->second->rotation * *ray});
    }
  }
  return bundles;
}

std::vector<TransferTerm> BuildTerms(const CameraContext& context, const std::vector<Track>& tracks,
                                     const std::vector<TrackAssociation>& associations,
                                     const TermOptions& options) {
  std::vector<TransferTerm> terms;
  const Eigen::Matrix2d floor_px2 =
      options.pixel_sigma_floor_px * options.pixel_sigma_floor_px * Eigen::Matrix2d::Identity();
  std::map<Timestamp, std::optional<TransferView>> views;
  const auto view_at = [&](const TrackObservation& observation) {
    auto [entry, inserted] = views.try_emplace(StampOf(context, observation));
    if (inserted) entry->second = ViewAt(context, observation);
    std::optional<TransferView> view = entry->second;
    if (view) view->pixel = observation.pixel;
    return view;
  };
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    if (!associations[i].accepted()) continue;
    const Track& track = tracks[i];
    if (track.observations.size() < 2) continue;
    const TrackObservation& reference = track.observations[track.reference];
    const auto source = view_at(reference);
    if (!source) continue;
    const double plane_extra = options.plane_sigma_per_thickness * associations[i].thickness_m;
    TransferTerm term;
    term.track = static_cast<int>(i);
    term.source_camera = context.camera;
    term.target_camera = context.camera;
    term.source = *source;
    term.source_covariance_px2 = floor_px2;
    term.plane_point_in_map_m = associations[i].point_in_map_m;
    term.plane_normal_in_map = associations[i].normal_in_map;
    term.plane_sigma_m = std::hypot(options.plane_sigma_floor_m, plane_extra);
    term.surface = associations[i].kind;
    const Timestamp source_stamp = StampOf(context, reference);
    if (!context.correction->empty()) term.source_place = context.correction->Locate(source_stamp);
    const int num_views = static_cast<int>(track.observations.size());
    for (const int k : Spread(num_views, options.max_views_per_track, track.reference)) {
      if (k == track.reference) continue;
      const TrackObservation& observation = track.observations[k];
      const auto target = view_at(observation);
      if (!target) continue;
      term.target = *target;
      term.target_covariance_px2 = observation.covariance_px2 + floor_px2;
      term.target_stamp_ns = StampOf(context, observation);
      if (!context.correction->empty()) {
        term.target_place = context.correction->Locate(term.target_stamp_ns);
      }
      terms.push_back(term);
    }
  }
  return terms;
}

std::vector<Track> SelectTracks(const std::vector<Track>& tracks, int max_tracks, int min_views,
                                int width_px, int height_px) {
  std::vector<TrackSummary> summaries;
  summaries.reserve(tracks.size());
  for (const Track& track : tracks) {
    const auto& observations = track.observations;
    const TrackObservation& middle = observations[observations.size() / 2];
    summaries.push_back({middle.stamp_ns, middle.pixel, observations.size()});
  }
  std::vector<Track> selected;
  for (const std::size_t i :
       SelectSpread(summaries, static_cast<std::size_t>(max_tracks),
                    static_cast<std::size_t>(min_views), width_px, height_px)) {
    selected.push_back(tracks[i]);
  }
  return selected;
}

}  // namespace scenecalib
