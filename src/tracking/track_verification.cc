#include "scenecalib/tracking/track_verification.h"

#include <tbb/parallel_for.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <map>
#include <optional>

#include "scenecalib/tracking/relative_motion.h"

namespace scenecalib {
namespace {

/// Neighbours that decide whether a feature's surroundings moved.
constexpr std::size_t kNumNeighbours = 12;

struct Sighting {
  int track = 0;
  int observation = 0;
  Eigen::Vector2d pixel;
  Eigen::Vector3d ray;
  Eigen::Matrix<double, 3, 2> ray_by_pixel;
};

/// Sightings of one image, by track.
using Frame = std::vector<Sighting>;

std::vector<Frame> SightingsByImage(const CameraModel& model, const std::vector<Track>& tracks) {
  std::map<Timestamp, Frame> frames;
  for (int t = 0; t < static_cast<int>(tracks.size()); ++t) {
    const auto& observations = tracks[t].observations;
    for (int o = 0; o < static_cast<int>(observations.size()); ++o) {
      UnprojectionJacobians jacobians;
      const auto ray = model.Unproject(observations[o].pixel, &jacobians);
      if (!ray) continue;
      frames[observations[o].stamp_ns].push_back(
          {t, o, observations[o].pixel, *ray, jacobians.ray_by_pixel});
    }
  }
  std::vector<Frame> ordered;
  ordered.reserve(frames.size());
  for (auto& [stamp_ns, frame] : frames) ordered.push_back(std::move(frame));
  return ordered;
}

/// Outcome for one pair of images: which sightings were compared and which of them contradict.
struct PairCheck {
  std::vector<std::pair<int, int>> compared;  ///< indices into the two frames
  std::vector<bool> inlier;
  double rms_px = 0.0;
};

double Median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::optional<PairCheck> CheckPair(const Frame& first, const Frame& second,
                                   const VerificationOptions& options, std::uint64_t seed) {
  PairCheck check;
  std::vector<RayPair> pairs;
  std::vector<double> motions_px;
  std::size_t j = 0;  // both frames are sorted by track
  for (std::size_t i = 0; i < first.size(); ++i) {
    while (j < second.size() && second[j].track < first[i].track) ++j;
    if (j == second.size()) break;
    if (second[j].track != first[i].track) continue;
    check.compared.emplace_back(static_cast<int>(i), static_cast<int>(j));
    pairs.push_back({first[i].ray, second[j].ray, first[i].ray_by_pixel, second[j].ray_by_pixel});
    motions_px.push_back((second[j].pixel - first[i].pixel).norm());
  }
  if (Median(motions_px) < options.min_motion_px) return std::nullopt;
  const auto motion = EstimateRelativeMotion(
      pairs, {options.ransac_iterations, options.max_epipolar_error_px, seed});
  // A motion that most of the tracks contradict is not the camera's.
  if (!motion || 2 * motion->num_inliers < static_cast<int>(pairs.size())) return std::nullopt;
  check.inlier = motion->inlier;
  check.rms_px = motion->inlier_rms_px;
  return check;
}

struct Votes {
  int num_compared = 0;
  int num_outliers = 0;
};

/// Drops what the votes condemn; keeps the reference index right.
void RemoveCondemned(const std::vector<std::vector<Votes>>& votes,
                     const VerificationOptions& options, std::vector<Track>* tracks,
                     VerificationEvidence* evidence) {
  std::vector<Track> kept;
  kept.reserve(tracks->size());
  for (std::size_t t = 0; t < tracks->size(); ++t) {
    Track& track = (*tracks)[t];
    Votes total;
    for (const Votes& v : votes[t]) {
      total.num_compared += v.num_compared;
      total.num_outliers += v.num_outliers;
    }
    const auto is_condemned = [](const Votes& v) {
      return v.num_compared > 0 && v.num_outliers == v.num_compared;
    };
    if (total.num_outliers > options.max_outlier_share * total.num_compared ||
        is_condemned(votes[t][track.reference])) {
      ++evidence->num_tracks_rejected;
      continue;
    }
    Track cleaned;
    cleaned.id = track.id;
    cleaned.patch_radius_px = track.patch_radius_px;
    for (int o = 0; o < static_cast<int>(track.observations.size()); ++o) {
      if (is_condemned(votes[t][o])) {
        ++evidence->num_observations_rejected;
        continue;
      }
      if (o == track.reference) cleaned.reference = static_cast<int>(cleaned.observations.size());
      cleaned.observations.push_back(track.observations[o]);
    }
    if (static_cast<int>(cleaned.observations.size()) < options.min_observations) {
      ++evidence->num_tracks_rejected;
      continue;
    }
    kept.push_back(std::move(cleaned));
  }
  *tracks = std::move(kept);
}

/// Drops tracks of things fixed to the vehicle; returns how many.
int RemoveFixed(const VerificationOptions& options, std::vector<Track>* tracks) {
  std::vector<FeatureMotion> motions(tracks->size());
  std::map<Timestamp, std::vector<std::pair<int, int>>> seen;  // track, observation
  for (int t = 0; t < static_cast<int>(tracks->size()); ++t) {
    const auto& observations = (*tracks)[t].observations;
    const TrackObservation& first = observations.front();
    motions[t].duration_s = SecondsBetween(first.stamp_ns, observations.back().stamp_ns);
    for (int o = 0; o < static_cast<int>(observations.size()); ++o) {
      motions[t].extent_px =
          std::max(motions[t].extent_px, (observations[o].pixel - first.pixel).norm());
      seen[observations[o].stamp_ns].emplace_back(t, o);
    }
  }
  std::vector<bool> is_fixed(tracks->size(), false);
  for (const auto& [stamp_ns, sightings] : seen) {
    std::vector<FeatureMotion> features;
    for (const auto& [t, o] : sightings) {
      features.push_back(motions[t]);
      features.back().pixel = (*tracks)[t].observations[o].pixel;
    }
    const std::vector<bool> fixed_here = FindFixedToVehicle(features, options);
    for (std::size_t k = 0; k < sightings.size(); ++k) {
      const auto [t, o] = sightings[k];
      const bool is_middle = o == static_cast<int>((*tracks)[t].observations.size()) / 2;
      if (is_middle && fixed_here[k]) is_fixed[t] = true;
    }
  }
  std::vector<Track> kept;
  kept.reserve(tracks->size());
  for (std::size_t t = 0; t < tracks->size(); ++t) {
    if (!is_fixed[t]) kept.push_back(std::move((*tracks)[t]));
  }
  const auto num_removed = static_cast<int>(tracks->size() - kept.size());
  *tracks = std::move(kept);
  return num_removed;
}

}  // namespace

VerificationEvidence VerifyTracks(const CameraModel& model, const VerificationOptions& options,
                                  std::vector<Track>* tracks) {
  VerificationEvidence evidence;
  evidence.num_tracks_fixed = RemoveFixed(options, tracks);
  const std::vector<Frame> frames = SightingsByImage(model, *tracks);
  const int num_pairs = std::max(0, static_cast<int>(frames.size()) - options.frame_gap);
  std::vector<std::optional<PairCheck>> checks(static_cast<std::size_t>(num_pairs));
  tbb::parallel_for(0, num_pairs, [&](int i) {
    checks[i] = CheckPair(frames[i], frames[i + options.frame_gap], options,
                          static_cast<std::uint64_t>(i) + 1);
  });

  std::vector<std::vector<Votes>> votes(tracks->size());
  for (std::size_t t = 0; t < tracks->size(); ++t) {
    votes[t].resize((*tracks)[t].observations.size());
  }
  std::vector<double> rms_px;
  for (int i = 0; i < num_pairs; ++i) {
    if (!checks[i]) {
      ++evidence.num_pairs_unchecked;
      continue;
    }
    ++evidence.num_pairs_checked;
    rms_px.push_back(checks[i]->rms_px);
    for (std::size_t k = 0; k < checks[i]->compared.size(); ++k) {
      const Sighting& a = frames[i][checks[i]->compared[k].first];
      const Sighting& b = frames[i + options.frame_gap][checks[i]->compared[k].second];
      for (Votes* v : {&votes[a.track][a.observation], &votes[b.track][b.observation]}) {
        ++v->num_compared;
        v->num_outliers += checks[i]->inlier[k] ? 0 : 1;
      }
    }
  }
  evidence.median_inlier_rms_px = Median(std::move(rms_px));
  RemoveCondemned(votes, options, tracks, &evidence);
  return evidence;
}

std::vector<bool> FindFixedToVehicle(const std::vector<FeatureMotion>& features,
                                     const VerificationOptions& options) {
  std::vector<bool> is_fixed(features.size(), false);
  std::vector<std::pair<double, double>>
      neighbours;  // squared distance, motion in this feature's time
  for (std::size_t i = 0; i < features.size(); ++i) {
    if (features[i].extent_px > options.static_extent_px) continue;
    neighbours.clear();
    for (std::size_t j = 0; j < features.size(); ++j) {
      // Others that stand still say nothing: a bonnet has many corners.
      if (features[j].extent_px <= options.static_extent_px) continue;
      if (!(features[j].duration_s > 0.0)) continue;
      neighbours.emplace_back(
          (features[j].pixel - features[i].pixel).squaredNorm(),
          features[j].extent_px * features[i].duration_s / features[j].duration_s);
    }
    if (neighbours.size() < kNumNeighbours) continue;
    const auto middle = neighbours.begin() + kNumNeighbours;
    std::partial_sort(neighbours.begin(), middle, neighbours.end());
    std::vector<double> extents_px;
    for (auto it = neighbours.begin(); it != middle; ++it) extents_px.push_back(it->second);
    is_fixed[i] = Median(std::move(extents_px)) > options.min_neighbour_motion_px;
  }
  return is_fixed;
}

}  // namespace scenecalib
