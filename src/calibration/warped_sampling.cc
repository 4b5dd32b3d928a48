#include "warped_sampling.h"

#include <algorithm>

namespace scenecalib {
namespace {

/// Grey value between pixels; beyond the border that of the border.
float Bilinear(const cv::Mat& image, const cv::Vec2f& at) {
  const float x = std::min(std::max(at[0], 0.0F), static_cast<float>(image.cols) - 1.001F);
  const float y = std::min(std::max(at[1], 0.0F), static_cast<float>(image.rows) - 1.001F);
  const int x0 = static_cast<int>(x);
  const int y0 = static_cast<int>(y);
  const float a = x - static_cast<float>(x0);
  const float b = y - static_cast<float>(y0);
  const uchar* row = image.ptr<uchar>(y0) + x0;
  const uchar* next = image.ptr<uchar>(y0 + 1) + x0;
  return (1.0F - b) * ((1.0F - a) * row[0] + a * row[1]) + b * ((1.0F - a) * next[0] + a * next[1]);
}

}  // namespace

cv::Mat1b SampleAt(const cv::Mat& source, const cv::Mat2f& map, bool is_finer) {
  cv::Mat1b sampled(map.size());
  for (int y = 0; y < map.rows; ++y) {
    for (int x = 0; x < map.cols; ++x) {
      const cv::Vec2f at = map(y, x);
      float grey = 0.0F;
      if (is_finer) {
        const cv::Vec2f right = map(y, std::min(x + 1, map.cols - 1)) - map(y, std::max(x - 1, 0));
        const cv::Vec2f down = map(std::min(y + 1, map.rows - 1), x) - map(std::max(y - 1, 0), x);
        for (const float a : {-0.125F, 0.125F}) {
          for (const float b : {-0.125F, 0.125F}) {
            grey += 0.25F * Bilinear(source, at + a * right + b * down);
          }
        }
      } else {
        grey = Bilinear(source, at);
      }
      sampled(y, x) = static_cast<uchar>(grey + 0.5F);
    }
  }
  return sampled;
}

}  // namespace scenecalib
