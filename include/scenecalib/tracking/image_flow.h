#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// An image's pyramid for Lucas-Kanade, in OpenCV's order: image, derivatives, half-size image, ...
using FlowPyramid = std::vector<cv::Mat>;

/// Pyramid of an 8-bit grey image; `equalise` spreads the grey values first (CLAHE), because
/// OpenCV's flow works on whole grey values and its thresholds know nothing of exposure.
FlowPyramid BuildFlowPyramid(const cv::Mat& image, bool equalise, const FlowOptions& options);

/// Where the pixels `before` of one image are in the next, searched from `predicted` there and back
/// again; none where the two disagree.
std::vector<std::optional<Eigen::Vector2d>> FlowThereAndBack(
    const FlowPyramid& first, const FlowPyramid& second, const std::vector<Eigen::Vector2d>& before,
    const std::vector<Eigen::Vector2d>& predicted, const FlowOptions& options);

}  // namespace scenecalib
