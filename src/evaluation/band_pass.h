#pragma once

#include <cstddef>
#include <cstdint>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

namespace scenecalib {

/// A picture of what can be compared between cameras: the brightness between two scales, divided by
/// its local contrast. Neither exposure nor vignetting nor a gamma curve changes it much.
class BandPassImage {
 public:
  BandPassImage() = default;
  /// `image` is CV_8UC1. Details finer than sigma_px and shades wider than about eight times that
  /// are gone. In one thread: the same numbers whatever runs beside it.
  BandPassImage(const cv::Mat& image, double sigma_px);

  /// Between four pixels; the caller stays within [0, columns - 1) x [0, rows - 1).
  float At(double x, double y) const {
    const int column = static_cast<int>(x);
    const int row = static_cast<int>(y);
    const float fx = static_cast<float>(x - column);
    const float fy = static_cast<float>(y - row);
    const std::int16_t* upper = values_.data() + static_cast<std::size_t>(row) * columns_ + column;
    const std::int16_t* lower = upper + columns_;
    const float above = static_cast<float>(upper[0]) + fx * static_cast<float>(upper[1] - upper[0]);
    const float below = static_cast<float>(lower[0]) + fx * static_cast<float>(lower[1] - lower[0]);
    return (above + fy * (below - above)) / kUnit;
  }
  /// The same for `count` places at once.
  void At(const float* x, const float* y, std::size_t count, float* values) const;
  bool Contains(double x, double y, double margin_px) const {
    return x >= margin_px && y >= margin_px && x < columns_ - 1 - margin_px &&
           y < rows_ - 1 - margin_px;
  }

  int columns() const { return columns_; }
  int rows() const { return rows_; }

 private:
  static constexpr float kUnit = 2048.0F;
  int columns_ = 0;
  int rows_ = 0;
  std::vector<std::int16_t> values_;  ///< in 1 / kUnit: many images are held at a time
};

}  // namespace scenecalib
