#include "scenecalib/tracking/track_selection.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

namespace scenecalib {

std::size_t TrackBudget(int num_tracks, const CameraModel& model, double duration_s) {
  constexpr double kOrdinaryDuration_s = 10.0;
  constexpr double kMaxForDuration = 3.0;
  constexpr double kOrdinaryHalfField_rad = 36.0 * M_PI / 180.0;
  constexpr double kMaxForField = 2.0;
  const double for_duration = std::clamp(duration_s / kOrdinaryDuration_s, 1.0, kMaxForDuration);
  const double half_field_rad = std::min(model.max_theta_rad(), kOrdinaryHalfField_rad);
  const double for_field =
      std::min(kMaxForField, std::tan(kOrdinaryHalfField_rad) / std::tan(half_field_rad));
  return static_cast<std::size_t>(std::lround(num_tracks * for_duration * for_field));
}

std::vector<std::size_t> SelectSpread(const std::vector<TrackSummary>& tracks,
                                      std::size_t max_tracks, std::size_t min_views, int width_px,
                                      int height_px) {
  constexpr int kGrid = 8;
  constexpr Timestamp kTimeBin_ns = 1000000000;
  // Buckets of (time, row, column); each gives up its longest track in turn.
  std::map<std::tuple<Timestamp, int, int>, std::vector<std::size_t>> buckets;
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    const TrackSummary& track = tracks[i];
    if (track.num_views < min_views) continue;
    const int row = static_cast<int>(kGrid * (track.pixel.y() + 0.5) / height_px);
    const int column = static_cast<int>(kGrid * (track.pixel.x() + 0.5) / width_px);
    buckets[{track.stamp_ns / kTimeBin_ns, row, column}].push_back(i);
  }
  for (auto& bucket : buckets) {
    std::stable_sort(bucket.second.begin(), bucket.second.end(),
                     [&tracks](std::size_t a, std::size_t b) {
                       return tracks[a].num_views > tracks[b].num_views;
                     });
  }
  std::vector<std::size_t> chosen;
  for (std::size_t rank = 0; chosen.size() < max_tracks; ++rank) {
    const std::size_t before = chosen.size();
    for (const auto& bucket : buckets) {
      if (rank >= bucket.second.size() || chosen.size() >= max_tracks) continue;
      chosen.push_back(bucket.second[rank]);
    }
    if (chosen.size() == before) break;
  }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

void DropShortest(int min_observations, std::size_t enough_observations,
                  std::vector<Track>* tracks) {
  const auto is_shortest = [min_observations](const Track& track) {
    return static_cast<int>(track.observations.size()) <= min_observations;
  };
  std::size_t num_observations = 0;
  for (const Track& track : *tracks) {
    if (!is_shortest(track)) num_observations += track.observations.size();
  }
  if (num_observations < enough_observations) return;
  tracks->erase(std::remove_if(tracks->begin(), tracks->end(), is_shortest), tracks->end());
}

}  // namespace scenecalib
