#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <opencv2/core.hpp>
#include <opencv2/core/hal/intrin.hpp>

// Reading of single grey values between pixels. Inline: a registration reads millions of them.

namespace scenecalib {

/// Weights of the cubic B-spline for the four pixels around a position with fraction t.
inline void SplineWeights(float t, float* weights) {
  const float u = 1.0F - t;
  weights[0] = u * u * u / 6.0F;
  weights[1] = 2.0F / 3.0F - t * t + 0.5F * t * t * t;
  weights[2] = 2.0F / 3.0F - u * u + 0.5F * u * u * u;
  weights[3] = t * t * t / 6.0F;
}

/// Their derivatives by t.
inline void SplineDerivatives(float t, float* weights) {
  const float u = 1.0F - t;
  weights[0] = -0.5F * u * u;
  weights[1] = -2.0F * t + 1.5F * t * t;
  weights[2] = 2.0F * u - 1.5F * u * u;
  weights[3] = 0.5F * t * t;
}

/// The weights in steps of 1/512 px: rounding to them is random from pixel to pixel of a patch.
class SplineTable {
 public:
  /// Weights as they are, and as two pairs of 16-bit integers that sum up to kOne.
  struct Entry {
    float weights[4];
    std::uint32_t pairs[2];
  };
  static constexpr int kOne = 1 << 14;

  SplineTable() {
    for (int i = 0; i <= kSteps; ++i) {
      Entry& entry = entries_[i];
      SplineWeights(static_cast<float>(i) / kSteps, entry.weights);
      std::uint32_t whole[4];
      for (int k : {0, 2, 3}) {
        whole[k] = static_cast<std::uint32_t>(std::lround(entry.weights[k] * kOne));
      }
      whole[1] = kOne - whole[0] - whole[2] - whole[3];
      entry.pairs[0] = whole[0] | (whole[1] << 16);
      entry.pairs[1] = whole[2] | (whole[3] << 16);
    }
  }

  const Entry& At(float fraction) const {
    return entries_[static_cast<int>(fraction * kSteps + 0.5F)];
  }

 private:
  static constexpr int kSteps = 512;
  Entry entries_[kSteps + 1];
};

/// The four by four pixels around a position: their first one, and where in the middle it lies.
struct Cell {
  const uchar* corner;
  float fraction_x;
  float fraction_y;
};

inline Cell Locate(const cv::Mat& image, float x, float y) {
  const int column = static_cast<int>(x);  // positions are positive: truncation is floor
  const int row = static_cast<int>(y);
  return {image.data + (row - 1) * image.step[0] + (column - 1), x - static_cast<float>(column),
          y - static_cast<float>(row)};
}

inline bool CanRead(const cv::Mat& image, double x, double y) {
  return x >= 1.0 && y >= 1.0 && x < image.cols - 3.0 && y < image.rows - 2.0;
}

inline std::uint32_t FourPixels(const uchar* row) {
  std::uint32_t pixels;
  std::memcpy(&pixels, row, sizeof(pixels));
  return pixels;
}

/// The cell's columns, summed with `down` and weighed with `across`: their sum is the grey value
/// under the spline, times SplineTable::kOne.
inline cv::v_float32x4 WeighColumns(const uchar* corner, std::size_t step,
                                    const SplineTable::Entry& across,
                                    const SplineTable::Entry& down) {
  const cv::v_uint32x4 even(FourPixels(corner), FourPixels(corner + 2 * step), 0, 0);
  const cv::v_uint32x4 odd(FourPixels(corner + step), FourPixels(corner + 3 * step), 0, 0);
  cv::v_uint8x16 rows, unused;  // two rows interleaved, then the other two
  cv::v_zip(cv::v_reinterpret_as_u8(even), cv::v_reinterpret_as_u8(odd), rows, unused);
  cv::v_uint16x8 upper, lower;
  cv::v_expand(rows, upper, lower);
  const cv::v_int32x4 sum =
      cv::v_dotprod(cv::v_reinterpret_as_s16(upper),
                    cv::v_reinterpret_as_s16(cv::v_setall_u32(down.pairs[0]))) +
      cv::v_dotprod(cv::v_reinterpret_as_s16(lower),
                    cv::v_reinterpret_as_s16(cv::v_setall_u32(down.pairs[1])));
  return cv::v_cvt_f32(sum) * cv::v_load(across.weights);
}

/// Between the middle four of the cell's pixels.
inline float Bilinear(const Cell& cell, std::size_t step) {
  const uchar* above = cell.corner + step + 1;
  const uchar* below = above + step;
  const float top = above[0] + cell.fraction_x * static_cast<float>(above[1] - above[0]);
  const float bottom = below[0] + cell.fraction_x * static_cast<float>(below[1] - below[0]);
  return top + cell.fraction_y * (bottom - top);
}

}  // namespace scenecalib
