#pragma once

#include <Eigen/Core>
#include <vector>

#include "scenecalib/tracking/live_tracker.h"

namespace scenecalib {

/// Where a feature is expected, and by how much its surroundings are stretched there.
struct FeaturePrediction {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Matrix2d affine_from_first = Eigen::Matrix2d::Identity();
};

/// Stamps of the last two images and of the one that is predicted.
struct PredictionTimes {
  Timestamp before_previous_ns = 0;
  Timestamp previous_ns = 0;
  Timestamp now_ns = 0;
};

/// Where the features go; parallel to `active`. A feature seen in the last two images goes on as
/// its scene point does when the camera's motion is repeated (SceneFlow::Continue). What moves by
/// itself, or without scene flow between those images (null), repeats its last step with its own
/// growth, as motion under perspective grows geometrically while things come nearer. A feature
/// without history goes with the scene flow around it or, where that says nothing, with its
/// neighbours. What was not seen in the last image stays.
std::vector<FeaturePrediction> PredictFeatures(const std::vector<ActiveTrack>& active,
                                               const SceneFlow* scene_flow,
                                               const PredictionTimes& times);

}  // namespace scenecalib
