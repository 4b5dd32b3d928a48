#include "scenecalib/tracking/image_flow.h"

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

namespace scenecalib {
namespace {

std::vector<cv::Point2f> ToPoints(const std::vector<Eigen::Vector2d>& pixels) {
  std::vector<cv::Point2f> points;
  points.reserve(pixels.size());
  for (const Eigen::Vector2d& pixel : pixels) {
    points.emplace_back(static_cast<float>(pixel.x()), static_cast<float>(pixel.y()));
  }
  return points;
}

}  // namespace

FlowPyramid BuildFlowPyramid(const cv::Mat& image, bool equalise, const FlowOptions& options) {
  cv::Mat equalised = image;
  if (equalise) cv::createCLAHE(4.0, {8, 8})->apply(image, equalised);
  FlowPyramid pyramid;
  const cv::Size window(options.window_px, options.window_px);
  cv::buildOpticalFlowPyramid(equalised, pyramid, window, options.pyramid_levels, true);
  return pyramid;
}

std::vector<std::optional<Eigen::Vector2d>> FlowThereAndBack(
    const FlowPyramid& first, const FlowPyramid& second, const std::vector<Eigen::Vector2d>& before,
    const std::vector<Eigen::Vector2d>& predicted, const FlowOptions& options) {
  std::vector<std::optional<Eigen::Vector2d>> flow(before.size());
  if (before.empty()) return flow;
  const std::vector<cv::Point2f> start = ToPoints(before);
  std::vector<cv::Point2f> after = ToPoints(predicted);
  std::vector<cv::Point2f> back = start;
  std::vector<uchar> found, found_back;
  std::vector<float> error;
  const cv::Size window(options.window_px, options.window_px);
  const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 20, 0.03);
  cv::calcOpticalFlowPyrLK(first, second, start, after, found, error, window,
                           options.pyramid_levels, criteria, cv::OPTFLOW_USE_INITIAL_FLOW);
  cv::calcOpticalFlowPyrLK(second, first, after, back, found_back, error, window,
                           options.pyramid_levels, criteria, cv::OPTFLOW_USE_INITIAL_FLOW);
  for (std::size_t i = 0; i < before.size(); ++i) {
    const cv::Point2f gap = back[i] - start[i];
    if (found[i] != 0 && found_back[i] != 0 &&
        std::hypot(gap.x, gap.y) <= options.max_forward_backward_px) {
      flow[i] = Eigen::Vector2d(after[i].x, after[i].y);
    }
  }
  return flow;
}

}  // namespace scenecalib
