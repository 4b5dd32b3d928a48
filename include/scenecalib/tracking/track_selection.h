#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/tracking/track.h"

namespace scenecalib {

/// What a selection needs to know of a track.
struct TrackSummary {
  Timestamp stamp_ns = 0;  ///< of its middle observation
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  std::size_t num_views = 0;
};

/// Indices, in increasing order, of at most `max_tracks` of the tracks with at least `min_views`:
/// long ones first, spread over time (seconds) and the image of the size given.
std::vector<std::size_t> SelectSpread(const std::vector<TrackSummary>& tracks,
                                      std::size_t max_tracks, std::size_t min_views, int width_px,
                                      int height_px);

/// Drops tracks with at most `min_observations` observations if the others have at least
/// `enough_observations` altogether: a track of three sightings is hardly verified, and only worth
/// having where there is little else.
void DropShortest(int min_observations, std::size_t enough_observations,
                  std::vector<Track>* tracks);

}  // namespace scenecalib
