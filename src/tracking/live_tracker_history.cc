// The part of a live tracker that looks back: which tracks have ended, what they say of the images
// behind it, and how it forgets those.

#include <algorithm>
#include <cstddef>
#include <iterator>
#include <optional>
#include <utility>
#include <vector>

#include "scenecalib/tracking/live_tracker.h"

namespace scenecalib {

int LiveTracker::EndOthers(const std::vector<char>& is_kept, bool forget) {
  const auto min_observations = static_cast<std::size_t>(options_.verification.min_observations);
  std::size_t num_kept = 0;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    if (is_kept[i] != 0) {
      if (num_kept != i) active_[num_kept] = std::move(active_[i]);
      ++num_kept;
    } else if (!forget && active_[i].track.observations.size() >= min_observations) {
      finished_.push_back(std::move(active_[i].track));
    }
  }
  const auto num_ended = static_cast<int>(active_.size() - num_kept);
  active_.erase(active_.begin() + static_cast<std::ptrdiff_t>(num_kept), active_.end());
  return num_ended;
}

std::optional<double> LiveTracker::TypicalMotionPx(Timestamp since_ns) const {
  constexpr std::size_t kMinFeatures = 12;
  // Not the median: the own vehicle may hold as many features as the scene.
  constexpr double kQuantile = 0.8;
  std::vector<double> motions_px;
  for (const ActiveTrack& track : active_) {
    if (track.num_missed > 0) continue;
    const auto& observations = track.track.observations;
    auto then = observations.rbegin();
    while (then != observations.rend() && then->stamp_ns > since_ns) ++then;
    if (then == observations.rend() || then->stamp_ns != since_ns) continue;
    motions_px.push_back((observations.back().pixel - then->pixel).norm());
  }
  if (motions_px.size() < kMinFeatures) return std::nullopt;
  const auto typical =
      motions_px.begin() +
      static_cast<std::ptrdiff_t>(kQuantile * static_cast<double>(motions_px.size() - 1));
  std::nth_element(motions_px.begin(), typical, motions_px.end());
  return *typical;
}

void LiveTracker::ForgetPrevious() {
  const Timestamp stamp_ns = before_previous_stamp_ns_;
  const auto forget = [stamp_ns](LiveTrack* track) {
    auto& observations = track->observations;
    auto found = observations.rbegin();
    while (found != observations.rend() && found->stamp_ns > stamp_ns) ++found;
    if (found != observations.rend() && found->stamp_ns == stamp_ns) {
      observations.erase(std::next(found).base());
    }
  };
  for (ActiveTrack& track : active_) forget(&track.track);
  // Those that ended before the newest image did not reach it.
  const std::size_t begin = std::min(num_finished_before_, finished_.size());
  for (std::size_t i = begin; i < finished_.size(); ++i) forget(&finished_[i]);
}

void LiveTracker::Forget(Timestamp stamp_ns) {
  const auto forget = [stamp_ns](LiveTrack* track) {
    auto& observations = track->observations;
    const auto first_kept = std::find_if(
        observations.begin(), observations.end(),
        [stamp_ns](const LiveObservation& observation) { return observation.stamp_ns > stamp_ns; });
    observations.erase(observations.begin(), first_kept);
  };
  for (ActiveTrack& track : active_) forget(&track.track);
  for (LiveTrack& track : finished_) forget(&track);
  const auto min_observations = static_cast<std::size_t>(options_.verification.min_observations);
  finished_.erase(std::remove_if(finished_.begin(), finished_.end(),
                                 [min_observations](const LiveTrack& track) {
                                   return track.observations.size() < min_observations;
                                 }),
                  finished_.end());
}

std::vector<LiveTrack> LiveTracker::Tracks() const {
  std::vector<LiveTrack> tracks = finished_;
  for (const ActiveTrack& track : active_) tracks.push_back(track.track);
  tracks.erase(std::remove_if(tracks.begin(), tracks.end(),
                              [](const LiveTrack& track) { return track.observations.empty(); }),
               tracks.end());
  return tracks;
}

}  // namespace scenecalib
