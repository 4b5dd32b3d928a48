#include "scenecalib/tracking/image_quality.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <vector>

namespace scenecalib {
namespace {

constexpr double kNumSamples = 20000.0;
/// Median of the absolute value of a normal variable, in standard deviations.
constexpr double kMedianOfNormal = 0.6745;
/// Norm of the mask [1 -2 1; -2 4 -2; 1 -2 1].
constexpr double kMixedDifferenceNorm = 6.0;

constexpr int kTilePx = 16;
constexpr int kTilesAcross = 40;
constexpr int kMinTexturedTiles = 12;

/// Mean squares over a tile.
struct TileEnergy {
  double gradient = 0.0;  ///< of the image, grey levels / px
  double change = 0.0;    ///< to the next image, less the tile's mean change
};

TileEnergy EnergyOf(const cv::Mat& image, const cv::Mat& next, int left, int top) {
  TileEnergy energy;
  double change_sum = 0.0;
  for (int y = top; y < top + kTilePx; ++y) {
    const uchar* above = image.ptr<uchar>(y - 1);
    const uchar* row = image.ptr<uchar>(y);
    const uchar* below = image.ptr<uchar>(y + 1);
    const uchar* later = next.ptr<uchar>(y);
    for (int x = left; x < left + kTilePx; ++x) {
      const double right = 0.5 * (row[x + 1] - row[x - 1]);
      const double down = 0.5 * (below[x] - above[x]);
      const double change = later[x] - row[x];
      energy.gradient += right * right + down * down;
      energy.change += change * change;
      change_sum += change;
    }
  }
  constexpr double kArea = kTilePx * kTilePx;
  energy.gradient /= kArea;
  energy.change = energy.change / kArea - std::pow(change_sum / kArea, 2);
  return energy;
}

}  // namespace

double ChangedShare(const cv::Mat& image, const cv::Mat& next, double noise_levels) {
  // Of two images' noise, with a margin, and of half a pixel's shift.
  const double noise = 4.5 * noise_levels * noise_levels + 1.0;
  constexpr double kShift = 0.25;
  const int step = std::max(kTilePx, image.cols / kTilesAcross);
  int num_textured = 0;
  int num_changed = 0;
  for (int top = 1; top + kTilePx < image.rows; top += step) {
    for (int left = 1; left + kTilePx < image.cols; left += step) {
      const TileEnergy energy = EnergyOf(image, next, left, top);
      // Enough for something else to differ by more than the noise.
      if (energy.gradient < 2.0 * noise) continue;
      ++num_textured;
      if (energy.change > noise + kShift * energy.gradient) ++num_changed;
    }
  }
  if (num_textured < kMinTexturedTiles) return 0.0;
  return static_cast<double>(num_changed) / num_textured;
}

ImageQuality MeasureImageQuality(const cv::Mat& image, const cv::Mat& mask) {
  ImageQuality quality;
  const double area = static_cast<double>(image.cols) * image.rows;
  const int step = std::max(1, static_cast<int>(std::sqrt(area / kNumSamples)));
  std::vector<int> histogram(16 * 255 + 1, 0);
  double sum = 0.0;
  double square_sum = 0.0;
  double gradient_sum = 0.0;
  int count = 0;
  for (int y = 1; y + 1 < image.rows; y += step) {
    const uchar* above = image.ptr<uchar>(y - 1);
    const uchar* row = image.ptr<uchar>(y);
    const uchar* below = image.ptr<uchar>(y + 1);
    const uchar* allowed = mask.empty() ? nullptr : mask.ptr<uchar>(y);
    for (int x = 1; x + 1 < image.cols; x += step) {
      if (allowed != nullptr && allowed[x] == 0) continue;
      sum += row[x];
      square_sum += row[x] * row[x];
      gradient_sum += 0.25 * (std::abs(row[x + 1] - row[x - 1]) + std::abs(below[x] - above[x]));
      const int mixed = above[x - 1] + above[x + 1] + below[x - 1] + below[x + 1] + 4 * row[x] -
                        2 * (above[x] + below[x] + row[x - 1] + row[x + 1]);
      ++histogram[static_cast<std::size_t>(std::abs(mixed))];
      ++count;
    }
  }
  if (count == 0) return quality;
  quality.mean = sum / count;
  quality.contrast = std::sqrt(std::max(0.0, square_sum / count - quality.mean * quality.mean));
  int below_median = 0;
  std::size_t median = 0;
  while (2 * (below_median + histogram[median]) < count) below_median += histogram[median++];
  // Within the median's bin, so that low noise does not come in steps.
  const double within =
      histogram[median] > 0 ? (0.5 * count - below_median) / histogram[median] - 0.5 : 0.0;
  quality.noise_levels = std::max(0.0, static_cast<double>(median) + within) /
                         (kMedianOfNormal * kMixedDifferenceNorm);
  // Noise alone: two differences of deviation sqrt(2) noise, of which 0.25 |.| is taken.
  const double noise_gradient = 0.5 * std::sqrt(2.0) * 0.7979 * quality.noise_levels;
  quality.sharpness = std::max(0.0, gradient_sum / count - noise_gradient);
  return quality;
}

std::map<Timestamp, double> RelativeSharpness(const std::map<Timestamp, cv::Mat>& images) {
  constexpr std::ptrdiff_t kReach = 4;
  std::vector<const cv::Mat*> in_order;
  for (const auto& [stamp_ns, image] : images) in_order.push_back(&image);
  const auto count = static_cast<std::ptrdiff_t>(in_order.size());
  std::vector<double> sharpness(in_order.size());
  tbb::parallel_for(std::ptrdiff_t{0}, count, [&](std::ptrdiff_t i) {
    sharpness[i] = MeasureImageQuality(*in_order[i], cv::Mat()).sharpness;
  });
  std::map<Timestamp, double> relative;
  std::ptrdiff_t i = 0;
  for (const auto& [stamp_ns, image] : images) {
    std::vector<double> near(sharpness.begin() + std::max(std::ptrdiff_t{0}, i - kReach),
                             sharpness.begin() + std::min(count, i + kReach + 1));
    const auto middle = near.begin() + static_cast<std::ptrdiff_t>(near.size() / 2);
    std::nth_element(near.begin(), middle, near.end());
    relative[stamp_ns] = *middle > 0.0 ? sharpness[i] / *middle : 1.0;
    ++i;
  }
  return relative;
}

}  // namespace scenecalib
