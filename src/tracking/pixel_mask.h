#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

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

/// The pixels that cv::circle fills, for masks that take thousands of circles of one size.
class Disc {
 public:
  explicit Disc(int radius_px) : radius_px_(radius_px) {
    cv::Mat1b drawn(2 * radius_px + 1, 2 * radius_px + 1, uchar{0});
    cv::circle(drawn, {radius_px, radius_px}, radius_px, cv::Scalar(255), cv::FILLED);
    for (int y = 0; y < drawn.rows; ++y) {
      half_width_px_.push_back((cv::countNonZero(drawn.row(y)) - 1) / 2);
    }
  }

  /// Of one byte a pixel; what lies outside is left out.
  void Fill(const cv::Point& center, uchar value, cv::Mat* mask) const {
    for (int dy = -radius_px_; dy <= radius_px_; ++dy) {
      const int y = center.y + dy;
      if (y < 0 || y >= mask->rows) continue;
      const int half = half_width_px_[static_cast<std::size_t>(dy + radius_px_)];
      const int begin = std::max(center.x - half, 0);
      const int end = std::min(center.x + half + 1, mask->cols);
      if (begin < end) {
        std::memset(mask->ptr<uchar>(y) + begin, value, static_cast<std::size_t>(end - begin));
      }
    }
  }

 private:
  int radius_px_;
  std::vector<int> half_width_px_;  ///< beside the middle, of each row
};

}  // namespace scenecalib
