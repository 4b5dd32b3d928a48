#include "patch_correlation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace scenecalib {
namespace {

/// Pixels of the patch that are read in every position: a chessboard would do, a grid is simpler.
constexpr int kStride = 2;
constexpr int kLanes = 8;
/// Half edge of the area whose centre of mass is taken.
constexpr int kMassRadius = 2;

/// Table that equalises the histogram of the pixels (of the mask, when there is one).
std::array<float, 256> EqualisingTable(const cv::Mat& image, const cv::Mat* mask) {
  std::array<int, 256> histogram{};
  int total = 0;
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      if (mask != nullptr && mask->at<uchar>(y, x) == 0) continue;
      ++histogram[image.at<uchar>(y, x)];
      ++total;
    }
  }
  std::array<float, 256> table{};
  int below = 0;
  for (int grey = 0; grey < 256; ++grey) {
    // The middle of the grey value's rank, so that a table of few values keeps its order.
    table[grey] = total > 0 ? (below + 0.5F * histogram[grey]) / total : 0.0F;
    below += histogram[grey];
  }
  return table;
}

struct Sample {
  int x;
  int y;
  float value;  ///< less the mean, of unit norm over all samples
};

std::vector<Sample> TemplateSamples(const cv::Mat& patch, const cv::Mat& mask) {
  const std::array<float, 256> table = EqualisingTable(patch, &mask);
  std::vector<Sample> samples;
  double mean = 0.0;
  for (int y = 0; y < patch.rows; y += kStride) {
    for (int x = 0; x < patch.cols; x += kStride) {
      if (mask.at<uchar>(y, x) == 0) continue;
      samples.push_back({x, y, table[patch.at<uchar>(y, x)]});
      mean += samples.back().value;
    }
  }
  if (samples.empty()) return samples;
  mean /= static_cast<double>(samples.size());
  double norm = 0.0;
  for (Sample& sample : samples) {
    sample.value -= static_cast<float>(mean);
    norm += sample.value * sample.value;
  }
  if (!(norm > 1e-6)) return {};
  for (Sample& sample : samples) sample.value /= static_cast<float>(std::sqrt(norm));
  return samples;
}

/// The window's rows are padded by kLanes pixels: so many positions next to each other are summed
/// up side by side, because the sums of a single one would wait for each other.
cv::Mat1f CorrelateEverywhere(const std::vector<Sample>& samples, const cv::Mat1f& padded_window,
                              int num_positions) {
  cv::Mat1f ncc(num_positions, num_positions);
  const auto count = static_cast<float>(samples.size());
  for (int v = 0; v < num_positions; ++v) {
    for (int first = 0; first < num_positions; first += kLanes) {
      float sum[kLanes] = {};
      float square[kLanes] = {};
      float product[kLanes] = {};
      for (const Sample& sample : samples) {
        const float* values = padded_window.ptr<float>(v + sample.y) + first + sample.x;
        for (int lane = 0; lane < kLanes; ++lane) {
          sum[lane] += values[lane];
          square[lane] += values[lane] * values[lane];
          product[lane] += values[lane] * sample.value;
        }
      }
      for (int lane = 0; lane < std::min(kLanes, num_positions - first); ++lane) {
        const float variance = square[lane] - sum[lane] * sum[lane] / count;
        ncc(v, first + lane) = variance > 1e-6F ? product[lane] / std::sqrt(variance) : -1.0F;
      }
    }
  }
  return ncc;
}

/// Equivalent diameter of the connected area about the peak above half of its height over the mean,
/// and the best local maximum outside of it.
void DescribePeak(const cv::Mat1f& ncc, const cv::Point& peak, CorrelationPeak* result) {
  const auto mean = static_cast<float>(cv::mean(ncc)[0]);
  const float half = 0.5F * (ncc(peak) + std::min(mean, ncc(peak)));
  cv::Mat1b in_peak = cv::Mat1b::zeros(ncc.size());
  std::vector<cv::Point> open = {peak};
  in_peak(peak) = 1;
  int area = 0;
  while (!open.empty()) {
    const cv::Point at = open.back();
    open.pop_back();
    ++area;
    for (const cv::Point& step :
         {cv::Point(1, 0), cv::Point(-1, 0), cv::Point(0, 1), cv::Point(0, -1)}) {
      const cv::Point next = at + step;
      if (!cv::Rect(cv::Point(0, 0), ncc.size()).contains(next) || in_peak(next) != 0 ||
          ncc(next) < half) {
        continue;
      }
      in_peak(next) = 1;
      open.push_back(next);
    }
  }
  result->width_px = std::sqrt(4.0 / M_PI * area);
  for (int v = 0; v < ncc.rows; ++v) {
    for (int u = 0; u < ncc.cols; ++u) {
      if (in_peak(v, u) == 0) {
        result->second_ncc = std::max(result->second_ncc, static_cast<double>(ncc(v, u)));
      }
    }
  }
}

Eigen::Vector2d CentreOfMass(const cv::Mat1f& ncc, const cv::Point& peak) {
  // Over the lowest value of the neighbourhood, so that the flat background does not pull inwards.
  const cv::Rect around = cv::Rect(peak.x - kMassRadius, peak.y - kMassRadius, 2 * kMassRadius + 1,
                                   2 * kMassRadius + 1) &
                          cv::Rect(cv::Point(0, 0), ncc.size());
  double lowest = 0.0;
  cv::minMaxLoc(ncc(around), &lowest);
  double mass = 0.0;
  Eigen::Vector2d moment = Eigen::Vector2d::Zero();
  for (int v = around.y; v < around.y + around.height; ++v) {
    for (int u = around.x; u < around.x + around.width; ++u) {
      const double weight = ncc(v, u) - lowest;
      mass += weight;
      moment += weight * Eigen::Vector2d(u, v);
    }
  }
  return mass > 0.0 ? Eigen::Vector2d(moment / mass) : Eigen::Vector2d(peak.x, peak.y);
}

}  // namespace

std::optional<CorrelationPeak> Correlate(const cv::Mat& patch, const cv::Mat& mask,
                                         const cv::Mat& window) {
  const std::vector<Sample> samples = TemplateSamples(patch, mask);
  if (samples.empty()) return std::nullopt;
  const std::array<float, 256> table = EqualisingTable(window, nullptr);
  cv::Mat1f equalised(window.rows, window.cols + kLanes, 0.0F);
  for (int y = 0; y < window.rows; ++y) {
    for (int x = 0; x < window.cols; ++x) equalised(y, x) = table[window.at<uchar>(y, x)];
  }
  const int num_positions = window.rows - patch.rows + 1;
  const cv::Mat1f ncc = CorrelateEverywhere(samples, equalised, num_positions);
  double best = 0.0;
  cv::Point peak;
  cv::minMaxLoc(ncc, nullptr, &best, nullptr, &peak);
  if (peak.x == 0 || peak.y == 0 || peak.x == num_positions - 1 || peak.y == num_positions - 1) {
    return std::nullopt;
  }
  CorrelationPeak result;
  result.ncc = best;
  DescribePeak(ncc, peak, &result);
  const int centre = num_positions / 2;
  result.shift_px = CentreOfMass(ncc, peak) - Eigen::Vector2d(centre, centre);
  return result;
}

}  // namespace scenecalib
