#include "scenecalib/tracking/image_flow.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

namespace scenecalib {
namespace {

/// Coarsest level: no narrower than this.
constexpr int kMinWidthPx = 60;

int BaseLevel(const cv::Mat& image, int full_size_width_px) {
  int level = 0;
  for (int width_px = image.cols; width_px > full_size_width_px; width_px /= 3) ++level;
  return level;
}

std::vector<cv::Point2f> ToPoints(const std::vector<Eigen::Vector2d>& pixels, double scale) {
  std::vector<cv::Point2f> points;
  points.reserve(pixels.size());
  for (const Eigen::Vector2d& pixel : pixels) {
    points.emplace_back(static_cast<float>(pixel.x() / scale),
                        static_cast<float>(pixel.y() / scale));
  }
  return points;
}

}  // namespace

FlowPyramid BuildFlowPyramid(const cv::Mat& image, bool equalise, const FlowOptions& options) {
  FlowPyramid pyramid;
  pyramid.base_level = BaseLevel(image, options.full_size_width_px);
  cv::Mat base = image;
  for (int i = 0; i < pyramid.base_level; ++i) {
    cv::Mat half;
    cv::pyrDown(base, half);
    base = half;
  }
  if (equalise) {
    cv::Mat equalised;
    cv::createCLAHE(4.0, {8, 8})->apply(base, equalised);
    base = equalised;
  }
  const cv::Size window(options.window_px, options.window_px);
  int levels = 0;
  while (levels < options.pyramid_levels && (base.cols >> (levels + 1)) >= kMinWidthPx) ++levels;
  cv::buildOpticalFlowPyramid(base, pyramid.levels, window, levels, true);
  return pyramid;
}

std::vector<std::optional<Eigen::Vector2d>> FlowThereAndBack(
    const FlowPyramid& first, const FlowPyramid& second, const std::vector<Eigen::Vector2d>& before,
    const std::vector<Eigen::Vector2d>& predicted, int num_levels, const FlowOptions& options) {
  std::vector<std::optional<Eigen::Vector2d>> flow(before.size());
  if (before.empty()) return flow;
  const double scale = first.scale();
  const std::vector<cv::Point2f> start = ToPoints(before, scale);
  std::vector<cv::Point2f> after = ToPoints(predicted, scale);
  std::vector<cv::Point2f> back = start;
  std::vector<uchar> found, found_back;
  std::vector<float> error;
  const cv::Size window(options.window_px, options.window_px);
  const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 10, 0.05);
  cv::calcOpticalFlowPyrLK(first.levels, second.levels, start, after, found, error, window,
                           num_levels, criteria, cv::OPTFLOW_USE_INITIAL_FLOW);
  cv::calcOpticalFlowPyrLK(second.levels, first.levels, after, back, found_back, error, window, 0,
                           criteria, cv::OPTFLOW_USE_INITIAL_FLOW);
  const double max_gap = options.max_forward_backward_px / std::max(1.0, 0.5 * scale);
  for (std::size_t i = 0; i < before.size(); ++i) {
    const cv::Point2f gap = back[i] - start[i];
    if (found[i] != 0 && found_back[i] != 0 && std::hypot(gap.x, gap.y) <= max_gap) {
      flow[i] = scale * Eigen::Vector2d(after[i].x, after[i].y);
    }
  }
  return flow;
}

}  // namespace scenecalib
