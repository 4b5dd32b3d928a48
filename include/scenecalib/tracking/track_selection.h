#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/tracking/track.h"

namespace scenecalib {

/// What a selection needs to know of a track.
struct TrackSummary {
  Timestamp stamp_ns = 0;  ///< of its middle observation
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  std::size_t num_views = 0;
};

/// How many tracks a camera is given where a wide one is given `num_tracks` for up to ten seconds:
/// more of a longer time, in proportion and up to three times as many; and up to twice as many in a
/// field of view narrower than 72 degrees from corner to corner, by the tangent of half of it, as a
/// narrow camera's tracks tell little of how far forward it is. 0 stays 0.
std::size_t TrackBudget(int num_tracks, const CameraModel& model, double duration_s);

/// Indices, in increasing order, of at most `max_tracks` of the tracks with at least `min_views`:
/// long ones first, spread over time (seconds) and the image of the size given.
std::vector<std::size_t> SelectSpread(const std::vector<TrackSummary>& tracks,
                                      std::size_t max_tracks, std::size_t min_views, int width_px,
                                      int height_px);

/// Drops the shortest tracks, of equally long ones the less certain first, as long as the others
/// have at least `enough_observations` altogether: a long track is better verified and tells more
/// than several short ones, which are only worth having where there is little else.
void DropShortest(std::size_t enough_observations, std::vector<Track>* tracks);

}  // namespace scenecalib
