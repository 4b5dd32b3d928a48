#include "scenecalib/tracking/new_features.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "pixel_mask.h"
#include "scenecalib/tracking/feature_detector.h"

namespace scenecalib {
namespace {

/// As for pixels of the base.
DetectionOptions Reduced(DetectionOptions options, double scale) {
  options.min_distance_px /= scale;
  options.bucket_px = static_cast<int>(std::lround(options.bucket_px / scale));
  return options;
}

/// Images after the one in which a feature is found that have to see it: fewer are no track.
constexpr int kMinViewsToCome = 2;

/// Whether a pixel's place stays in what can be seen, were the motion to go on.
bool StaysInSight(Eigen::Vector2d pixel, const FeatureSurroundings& surroundings) {
  for (int i = 0; i < kMinViewsToCome; ++i) {
    const auto step = surroundings.flow->Predict(pixel);
    if (!step || !IsSet(surroundings.domain, step->center_px)) return false;
    pixel = step->center_px;
  }
  return true;
}

void LeaveOutWhatIsAboutToGo(const FeatureSurroundings& surroundings, double scale, cv::Mat* mask) {
  constexpr int kCellsAcross = 24;
  const int cell_px = std::max(8, mask->cols / kCellsAcross);
  const int columns = (mask->cols + cell_px - 1) / cell_px;
  const int rows = (mask->rows + cell_px - 1) / cell_px;
  const cv::Rect whole(0, 0, mask->cols, mask->rows);
  for (int cell = 0; cell < columns * rows; ++cell) {
    const Eigen::Vector2d center =
        scale * cell_px * Eigen::Vector2d(cell % columns + 0.5, cell / columns + 0.5);
    if (!IsSet(surroundings.domain, center)) continue;
    if (StaysInSight(center, surroundings)) continue;
    const cv::Rect area(cell % columns * cell_px, cell / columns * cell_px, cell_px, cell_px);
    (*mask)(area & whole).setTo(0);
  }
}

cv::Mat MaskOf(const FlowPyramid& pyramid, const FeatureSurroundings& surroundings) {
  cv::Mat mask;
  cv::resize(surroundings.allowed, mask, pyramid.base().size(), 0.0, 0.0, cv::INTER_NEAREST);
  const double scale = pyramid.scale();
  const Disc avoided(static_cast<int>(surroundings.avoided_radius_px / scale));
  for (const Eigen::Vector2d& pixel : surroundings.avoided) {
    avoided.Fill(ToPoint(pixel / scale), 0, &mask);
  }
  if (surroundings.flow != nullptr) LeaveOutWhatIsAboutToGo(surroundings, scale, &mask);
  return mask;
}

}  // namespace

DetectionOptions ForFieldOfView(DetectionOptions options, double max_theta_rad) {
  constexpr double kOrdinary_rad = 45.0 * M_PI / 180.0;
  const double factor = std::clamp(max_theta_rad / kOrdinary_rad, 1.0, options.max_wide_factor);
  options.max_features = static_cast<int>(std::lround(options.max_features * factor));
  options.min_distance_px /= factor;
  return options;
}

void NewFeatures::Learn(const FlowPyramid& pyramid, const std::vector<FeatureTrial>& trials) {
  constexpr double kLearningRate = 0.06;
  constexpr double kMinSurvival = 0.1;
  const cv::Mat& base = pyramid.base();
  const BucketGrid buckets(base.size(), Reduced(options_, pyramid.scale()).bucket_px);
  survival_.resize(buckets.size(), 1.0);
  for (const FeatureTrial& trial : trials) {
    const Eigen::Vector2d pixel = trial.pixel / pyramid.scale();
    double& survival =
        survival_[buckets.At(std::clamp(static_cast<int>(pixel.x()), 0, base.cols - 1),
                             std::clamp(static_cast<int>(pixel.y()), 0, base.rows - 1))];
    survival += kLearningRate * ((trial.is_followed ? 1.0 : 0.0) - survival);
    survival = std::max(survival, kMinSurvival);
  }
}

std::vector<Eigen::Vector2d> NewFeatures::Find(const FlowPyramid& pyramid,
                                               const FeatureSurroundings& surroundings) const {
  const double scale = pyramid.scale();
  std::vector<Eigen::Vector2d> live;
  live.reserve(surroundings.live.size());
  for (const Eigen::Vector2d& pixel : surroundings.live) live.push_back(pixel / scale);
  std::vector<Eigen::Vector2d> found;
  for (const Eigen::Vector2d& pixel : DetectFeatures(pyramid.base(), MaskOf(pyramid, surroundings),
                                                     live, Reduced(options_, scale), survival_)) {
    if (IsSet(surroundings.domain, scale * pixel)) found.push_back(scale * pixel);
  }
  return found;
}

}  // namespace scenecalib
