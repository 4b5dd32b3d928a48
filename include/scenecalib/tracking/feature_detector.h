#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <vector>

#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// New corners (Shi-Tomasi: smaller eigenvalue of the structure tensor) in an 8-bit grey image,
/// spread over buckets, at least min_distance_px from `live` features and from each other, only
/// where `mask` (same size, 8-bit) is not zero; together with the live ones at most max_features.
/// Strongest first; whole pixels, because any point of a patch serves as well as any other.
std::vector<Eigen::Vector2d> DetectFeatures(const cv::Mat& image, const cv::Mat& mask,
                                            const std::vector<Eigen::Vector2d>& live,
                                            const DetectionOptions& options);

}  // namespace scenecalib
