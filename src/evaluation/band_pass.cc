#include "band_pass.h"

#include <algorithm>
#include <cmath>
#include <cstring>

// OpenCV's filters split their work by the number of threads and may round differently for it; here
// everything is plain loops.

namespace scenecalib {
namespace {

constexpr double kWideOverFine = 8.0;
/// Rows whose running sums are carried on side by side: one alone waits for each addition.
constexpr int kRowsAtOnce = 8;
/// Contrast, in grey levels, below which brightness is rather noise than texture.
constexpr float kContrastFloor = 3.0F;

struct Plane {
  int columns = 0;
  int rows = 0;
  std::vector<float> values;

  float* Row(int row) { return values.data() + static_cast<std::size_t>(row) * columns; }
  const float* Row(int row) const {
    return values.data() + static_cast<std::size_t>(row) * columns;
  }
};

int Clamp(int value, int count) { return std::min(std::max(value, 0), count - 1); }

std::vector<float> GaussianKernel(double sigma_px) {
  const int radius = std::max(1, static_cast<int>(std::ceil(2.5 * sigma_px)));
  std::vector<float> kernel;
  float sum = 0.0F;
  for (int k = -radius; k <= radius; ++k) {
    kernel.push_back(static_cast<float>(std::exp(-0.5 * k * k / (sigma_px * sigma_px))));
    sum += kernel.back();
  }
  for (float& weight : kernel) weight /= sum;
  return kernel;
}

/// Convolution of rows and columns; the border is repeated.
Plane Smooth(const Plane& in, double sigma_px) {
  const std::vector<float> kernel = GaussianKernel(sigma_px);
  const int radius = static_cast<int>(kernel.size() / 2);
  Plane vertical{in.columns, in.rows, std::vector<float>(in.values.size(), 0.0F)};
  for (int row = 0; row < in.rows; ++row) {
    float* out = vertical.Row(row);
    for (int k = -radius; k <= radius; ++k) {
      const float weight = kernel[static_cast<std::size_t>(k + radius)];
      const float* source = in.Row(Clamp(row + k, in.rows));
      for (int column = 0; column < in.columns; ++column) out[column] += weight * source[column];
    }
  }
  Plane out{in.columns, in.rows, std::vector<float>(in.values.size())};
  std::vector<float> padded(static_cast<std::size_t>(in.columns + 2 * radius));
  for (int row = 0; row < in.rows; ++row) {
    const float* source = vertical.Row(row);
    for (int column = 0; column < static_cast<int>(padded.size()); ++column) {
      padded[static_cast<std::size_t>(column)] = source[Clamp(column - radius, in.columns)];
    }
    float* target = out.Row(row);
    for (std::size_t k = 0; k < kernel.size(); ++k) {
      const float weight = kernel[k];
      const float* shifted = padded.data() + k;
      for (int column = 0; column < in.columns; ++column) {
        target[column] += weight * shifted[column];
      }
    }
  }
  return out;
}

/// Mean over squares of edge 2 radius + 1, by running sums; the border is repeated.
Plane BoxMean(const Plane& in, int radius) {
  const float scale = 1.0F / static_cast<float>(2 * radius + 1);
  Plane horizontal{in.columns, in.rows, std::vector<float>(in.values.size())};
  for (int first = 0; first < in.rows; first += kRowsAtOnce) {
    double sums[kRowsAtOnce] = {};
    const float* source[kRowsAtOnce];
    float* out[kRowsAtOnce];
    for (int r = 0; r < kRowsAtOnce; ++r) {
      source[r] = in.Row(std::min(first + r, in.rows - 1));
      out[r] = horizontal.Row(std::min(first + r, in.rows - 1));
      for (int k = -radius; k <= radius; ++k) sums[r] += source[r][Clamp(k, in.columns)];
    }
    for (int column = 0; column < in.columns; ++column) {
      const int entering = Clamp(column + radius + 1, in.columns);
      const int leaving = Clamp(column - radius, in.columns);
      for (int r = 0; r < kRowsAtOnce; ++r) {
        out[r][column] = static_cast<float>(sums[r]) * scale;
        sums[r] += source[r][entering];
        sums[r] -= source[r][leaving];
      }
    }
  }
  Plane out{in.columns, in.rows, std::vector<float>(in.values.size())};
  std::vector<double> sums(static_cast<std::size_t>(in.columns), 0.0);
  for (int k = -radius; k <= radius; ++k) {
    const float* source = horizontal.Row(Clamp(k, in.rows));
    for (int column = 0; column < in.columns; ++column) sums[column] += source[column];
  }
  for (int row = 0; row < in.rows; ++row) {
    float* target = out.Row(row);
    const float* entering = horizontal.Row(Clamp(row + radius + 1, in.rows));
    const float* leaving = horizontal.Row(Clamp(row - radius, in.rows));
    for (int column = 0; column < in.columns; ++column) {
      target[column] = static_cast<float>(sums[column]) * scale;
      sums[column] += entering[column] - leaving[column];
    }
  }
  return out;
}

/// Two box means are near enough to a Gaussian of that deviation.
Plane SmoothWide(const Plane& in, double sigma_px) {
  const int radius = std::max(1, static_cast<int>(std::lround(1.22 * sigma_px)));
  return BoxMean(BoxMean(in, radius), radius);
}

}  // namespace

BandPassImage::BandPassImage(const cv::Mat& image, double sigma_px)
    : columns_(image.cols), rows_(image.rows) {
  Plane grey{columns_, rows_, std::vector<float>(static_cast<std::size_t>(columns_) * rows_)};
  for (int row = 0; row < rows_; ++row) {
    const unsigned char* source = image.ptr<unsigned char>(row);
    std::copy(source, source + columns_, grey.Row(row));
  }
  Plane fine = Smooth(grey, sigma_px);
  const Plane wide = SmoothWide(fine, kWideOverFine * sigma_px);
  for (std::size_t i = 0; i < fine.values.size(); ++i) fine.values[i] -= wide.values[i];
  Plane square = fine;
  for (float& value : square.values) value *= value;
  square = SmoothWide(square, kWideOverFine * sigma_px);
  constexpr float kLargest = 15.0F;
  values_.resize(fine.values.size());
  for (std::size_t i = 0; i < values_.size(); ++i) {
    const float contrast =
        std::sqrt(std::max(0.0F, square.values[i]) + kContrastFloor * kContrastFloor);
    const float value = std::min(kLargest, std::max(-kLargest, fine.values[i] / contrast));
    values_[i] = static_cast<std::int16_t>(kUnit * value + std::copysign(0.5F, value));
  }
}

void BandPassImage::At(const float* x, const float* y, std::size_t count, float* values) const {
  constexpr std::size_t kAtOnce = 64;
  int offset[kAtOnce];
  float fx[kAtOnce], fy[kAtOnce];
  std::int32_t above[kAtOnce], below[kAtOnce];  // two neighbours each, the left one in the low half
  for (std::size_t first = 0; first < count; first += kAtOnce) {
    const std::size_t n = std::min(kAtOnce, count - first);
    for (std::size_t k = 0; k < n; ++k) {
      const int column = static_cast<int>(x[first + k]);
      const int row = static_cast<int>(y[first + k]);
      fx[k] = x[first + k] - static_cast<float>(column);
      fy[k] = y[first + k] - static_cast<float>(row);
      offset[k] = row * columns_ + column;
    }
    for (std::size_t k = 0; k < n; ++k) {
      const std::int16_t* upper = values_.data() + offset[k];
      std::memcpy(&above[k], upper, sizeof(above[k]));
      std::memcpy(&below[k], upper + columns_, sizeof(below[k]));
    }
    for (std::size_t k = 0; k < n; ++k) {
      const auto top_left = static_cast<float>(static_cast<std::int16_t>(above[k]));
      const auto top_right = static_cast<float>(above[k] >> 16);
      const auto bottom_left = static_cast<float>(static_cast<std::int16_t>(below[k]));
      const auto bottom_right = static_cast<float>(below[k] >> 16);
      const float top = top_left + fx[k] * (top_right - top_left);
      const float bottom = bottom_left + fx[k] * (bottom_right - bottom_left);
      values[first + k] = (top + fy[k] * (bottom - top)) / kUnit;
    }
  }
}

}  // namespace scenecalib
