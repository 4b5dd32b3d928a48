#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <vector>

#include "scenecalib/tracking/image_flow.h"
#include "scenecalib/tracking/scene_flow.h"
#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// What new features have to keep off, in pixels of the full image.
struct FeatureSurroundings {
  cv::Mat domain;   ///< zero where a whole patch does not see the scene through the model
  cv::Mat allowed;  ///< zero, besides, on what is fixed to the vehicle
  std::vector<Eigen::Vector2d> live;     ///< features that are followed
  std::vector<Eigen::Vector2d> avoided;  ///< where a patch was just found to straddle an edge
  int avoided_radius_px = 0;
  const SceneFlow* flow = nullptr;  ///< of the last two images, if known
};

/// A feature's second image.
struct FeatureTrial {
  Eigen::Vector2d pixel;  ///< where it was found
  bool is_followed = false;
};

/// Options for a camera that sees up to this angle from its axis:
/// DetectionOptions::max_wide_factor.
DetectionOptions ForFieldOfView(DetectionOptions options, double max_theta_rad);

/// Chooses new features from image to image, and learns where they can be followed.
class NewFeatures {
 public:
  explicit NewFeatures(const DetectionOptions& options) : options_(options) {}

  /// Where new features are lost at once (the near road, foliage, junctions of things at different
  /// depths) few are tried from then on, so that there is room for others.
  void Learn(const FlowPyramid& pyramid, const std::vector<FeatureTrial>& trials);

  /// Pixels of the full image, found in the pyramid's base: not where a feature would be out of the
  /// image in the next one, were the motion to go on.
  std::vector<Eigen::Vector2d> Find(const FlowPyramid& pyramid,
                                    const FeatureSurroundings& surroundings) const;

 private:
  DetectionOptions options_;
  /// Share of the new features of late that could be followed, by bucket of the pyramid's base.
  std::vector<double> survival_;
};

}  // namespace scenecalib
