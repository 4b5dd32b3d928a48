#include "scenecalib/tracking/track_selection.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
#include <utility>

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

void DropShortest(std::size_t enough_observations, std::vector<Track>* tracks) {
  struct Entry {
    std::size_t length = 0;
    double variance_px2 = 0.0;
    std::size_t index = 0;
  };
  std::vector<Entry> entries(tracks->size());
  std::size_t num_left = 0;
  for (std::size_t i = 0; i < tracks->size(); ++i) {
    const auto& observations = (*tracks)[i].observations;
    double sum_px2 = 0.0;
    for (const TrackObservation& o : observations) sum_px2 += o.covariance_px2.trace();
    const auto length = static_cast<double>(std::max<std::size_t>(1, observations.size()));
    entries[i] = {observations.size(), sum_px2 / length, i};
    num_left += observations.size();
  }
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
    return std::tie(a.length, b.variance_px2, a.index) <
           std::tie(b.length, a.variance_px2, b.index);
  });
  std::vector<char> is_dropped(tracks->size(), 0);
  for (const Entry& entry : entries) {
    if (num_left < enough_observations + entry.length) break;
    num_left -= entry.length;
    is_dropped[entry.index] = 1;
  }
  std::vector<Track> kept;
  for (std::size_t i = 0; i < tracks->size(); ++i) {
    if (is_dropped[i] == 0) kept.push_back(std::move((*tracks)[i]));
  }
  *tracks = std::move(kept);
}

}  // namespace scenecalib
