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

/// Where the features go; parallel to `active`. Motion under perspective grows geometrically as
/// things come nearer, so the last step is repeated with its own growth; a feature without history
/// goes with the scene flow between the last two images or, where that (null: none) says nothing,
/// with its neighbours. What was not seen in the last image stays.
std::vector<FeaturePrediction> PredictFeatures(const std::vector<ActiveTrack>& active,
                                               const SceneFlow* scene_flow,
                                               const PredictionTimes& times);

}  // namespace scenecalib
