#include "band_pass.h"

#include <algorithm>
#include <cmath>
#include <cstring>

// OpenCV's filters split their work by the number of threads and may round differently for it; here
// everything is plain loops.

namespace scenecalib {
namespace {

constexpr double kWideOverFine = 8.0;
/// Sequences whose running sums are carried on side by side: one alone waits for each addition.
constexpr int kLanes = 16;
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
Plane Smooth(const cv::Mat& in, double sigma_px) {
  const std::vector<float> kernel = GaussianKernel(sigma_px);
  const int radius = static_cast<int>(kernel.size() / 2);
  Plane out{in.cols, in.rows, std::vector<float>(static_cast<std::size_t>(in.cols) * in.rows)};
  std::vector<float> padded(static_cast<std::size_t>(in.cols + 2 * radius));
  float* vertical = padded.data() + radius;
  for (int row = 0; row < in.rows; ++row) {
    std::fill(padded.begin(), padded.end(), 0.0F);
    for (int k = -radius; k <= radius; ++k) {
      const float weight = kernel[static_cast<std::size_t>(k + radius)];
      const unsigned char* source = in.ptr<unsigned char>(Clamp(row + k, in.rows));
      for (int column = 0; column < in.cols; ++column) {
        vertical[column] += weight * static_cast<float>(source[column]);
      }
    }
    std::fill(padded.begin(), padded.begin() + radius, vertical[0]);
    std::fill(padded.end() - radius, padded.end(), vertical[in.cols - 1]);
    float* target = out.Row(row);
    for (std::size_t k = 0; k < kernel.size(); ++k) {
      const float weight = kernel[k];
      const float* shifted = padded.data() + k;
      for (int column = 0; column < in.cols; ++column) target[column] += weight * shifted[column];
    }
  }
  return out;
}

/// Means over 2 radius + 1 values of kLanes sequences of `count` values that lie side by side, by
/// running sums; the border is repeated.
void RunningMeans(const float* in, int count, int radius, float* out) {
  const float scale = 1.0F / static_cast<float>(2 * radius + 1);
  float sums[kLanes] = {};
  const auto at = [&](int i) { return in + static_cast<std::ptrdiff_t>(Clamp(i, count)) * kLanes; };
  for (int k = -radius; k <= radius; ++k) {
    for (int lane = 0; lane < kLanes; ++lane) sums[lane] += at(k)[lane];
  }
  for (int i = 0; i < count; ++i, out += kLanes) {
    const float* entering = at(i + radius + 1);
    const float* leaving = at(i - radius);
    for (int lane = 0; lane < kLanes; ++lane) {
      out[lane] = sums[lane] * scale;
      sums[lane] += entering[lane] - leaving[lane];
    }
  }
}

/// Two means over squares, which are near enough to a Gaussian of that deviation.
Plane SmoothWide(const Plane& in, double sigma_px) {
  const int radius = std::max(1, static_cast<int>(std::lround(1.22 * sigma_px)));
  Plane out = in;
  std::vector<float> once(static_cast<std::size_t>(std::max(in.columns, in.rows)) * kLanes);
  std::vector<float> strip(once.size());
  const auto smooth = [&](int count) {
    RunningMeans(strip.data(), count, radius, once.data());
    RunningMeans(once.data(), count, radius, strip.data());
  };
  for (int first = 0; first < in.columns; first += kLanes) {
    const int lanes = std::min(kLanes, in.columns - first);
    for (int row = 0; row < in.rows; ++row) {
      std::copy_n(out.Row(row) + first, lanes, &strip[static_cast<std::size_t>(row) * kLanes]);
    }
    smooth(in.rows);
    for (int row = 0; row < in.rows; ++row) {
      std::copy_n(&strip[static_cast<std::size_t>(row) * kLanes], lanes, out.Row(row) + first);
    }
  }
  for (int first = 0; first < in.rows; first += kLanes) {
    const int lanes = std::min(kLanes, in.rows - first);
    for (int lane = 0; lane < lanes; ++lane) {
      const float* source = out.Row(first + lane);
      for (int column = 0; column < in.columns; ++column) {
        strip[static_cast<std::size_t>(column) * kLanes + lane] = source[column];
      }
    }
    smooth(in.columns);
    for (int lane = 0; lane < lanes; ++lane) {
      float* target = out.Row(first + lane);
      for (int column = 0; column < in.columns; ++column) {
        target[column] = strip[static_cast<std::size_t>(column) * kLanes + lane];
      }
    }
  }
  return out;
}

}  // namespace

BandPassImage::BandPassImage(const cv::Mat& image, double sigma_px)
    : columns_(image.cols), rows_(image.rows) {
  Plane fine = Smooth(image, sigma_px);
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
