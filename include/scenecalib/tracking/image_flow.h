#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// An image's pyramid for Lucas-Kanade. It leaves out the finest levels of a large image: the
/// search only has to bring a feature near enough for its registration at full resolution.
struct FlowPyramid {
  int base_level = 0;           ///< halvings of the image below levels[0]
  std::vector<cv::Mat> levels;  ///< in OpenCV's order: image, derivatives, half-size image, ...

  const cv::Mat& base() const { return levels.front(); }
  /// Pixels of the full image per pixel of base().
  double scale() const { return static_cast<double>(1 << base_level); }
};

/// Pyramid of an 8-bit grey image; `equalise` spreads the grey values first (CLAHE), because
/// OpenCV's flow works on whole grey values and its thresholds know nothing of exposure.
FlowPyramid BuildFlowPyramid(const cv::Mat& image, bool equalise, const FlowOptions& options);

/// Where the pixels `before` of one full-size image are in the next, searched from `predicted`
/// there, through `num_levels` levels above the finest one, and on the finest one back again; none
/// where the two disagree.
std::vector<std::optional<Eigen::Vector2d>> FlowThereAndBack(
    const FlowPyramid& first, const FlowPyramid& second, const std::vector<Eigen::Vector2d>& before,
    const std::vector<Eigen::Vector2d>& predicted, int num_levels, const FlowOptions& options);

}  // namespace scenecalib
