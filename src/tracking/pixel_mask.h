#pragma once

#include <Eigen/Core>
#include <cmath>
#include <opencv2/core.hpp>

namespace scenecalib {

/// False outside the mask.
inline bool IsSet(const cv::Mat& mask, const Eigen::Vector2d& pixel) {
  const auto x = std::lround(pixel.x());
  const auto y = std::lround(pixel.y());
  return x >= 0 && y >= 0 && x < mask.cols && y < mask.rows &&
         mask.at<uchar>(static_cast<int>(y), static_cast<int>(x)) != 0;
}

inline cv::Point2f ToPoint(const Eigen::Vector2d& pixel) {
  return {static_cast<float>(pixel.x()), static_cast<float>(pixel.y())};
}

}  // namespace scenecalib
