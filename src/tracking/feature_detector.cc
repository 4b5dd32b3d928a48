#include "scenecalib/tracking/feature_detector.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "pixel_mask.h"

namespace scenecalib {
namespace {

struct Corner {
  float score;
  int x;
  int y;
};

/// Local maxima of the corner score above the threshold, strongest first; ties in raster order.
std::vector<Corner> FindCorners(const cv::Mat& image, const cv::Mat& mask, double min_relative) {
  cv::Mat score, dilated;
  cv::cornerMinEigenVal(image, score, 5, 3);
  double max_score = 0.0;
  cv::minMaxLoc(score, nullptr, &max_score, nullptr, nullptr, mask);
  cv::dilate(score, dilated, cv::Mat());
  const auto threshold = static_cast<float>(max_score * min_relative);
  std::vector<Corner> corners;
  for (int y = 2; y < image.rows - 2; ++y) {
    const float* row = score.ptr<float>(y);
    const float* neighbourhood = dilated.ptr<float>(y);
    const uchar* allowed = mask.ptr<uchar>(y);
    for (int x = 2; x < image.cols - 2; ++x) {
      if (allowed[x] != 0 && row[x] > threshold && row[x] == neighbourhood[x]) {
        corners.push_back({row[x], x, y});
      }
    }
  }
  std::stable_sort(corners.begin(), corners.end(),
                   [](const Corner& a, const Corner& b) { return a.score > b.score; });
  return corners;
}

/// Which buckets and which surroundings are taken.
class Occupancy {
 public:
  Occupancy(const cv::Size& size, const DetectionOptions& options,
            const std::vector<double>& share_of_bucket)
      : taken_(size, CV_8UC1, cv::Scalar(0)),
        disc_(static_cast<int>(std::lround(options.min_distance_px))),
        buckets_(size, options.bucket_px),
        room_(buckets_.size()) {
    const double even =
        options.bucket_share * options.max_features / static_cast<double>(room_.size());
    for (std::size_t i = 0; i < room_.size(); ++i) {
      const double share = i < share_of_bucket.size() ? share_of_bucket[i] : 1.0;
      room_[i] = static_cast<int>(std::ceil(share * even));
    }
  }

  bool IsFree(int x, int y) const {
    return taken_.at<uchar>(y, x) == 0 && room_[buckets_.At(x, y)] > 0;
  }

  void Take(int x, int y) {
    disc_.Fill({x, y}, 255, &taken_);
    --room_[buckets_.At(x, y)];
  }

 private:
  cv::Mat taken_;
  Disc disc_;  ///< around a feature
  BucketGrid buckets_;
  std::vector<int> room_;  ///< left in each bucket
};

}  // namespace

std::vector<Eigen::Vector2d> DetectFeatures(const cv::Mat& image, const cv::Mat& mask,
                                            const std::vector<Eigen::Vector2d>& live,
                                            const DetectionOptions& options,
                                            const std::vector<double>& share_of_bucket) {
  std::vector<Eigen::Vector2d> features;
  int missing = options.max_features - static_cast<int>(live.size());
  if (missing <= 0) return features;
  cv::Scalar mean, contrast;
  cv::meanStdDev(image, mean, contrast, mask);
  if (contrast[0] < options.min_contrast) return features;

  Occupancy occupancy(image.size(), options, share_of_bucket);
  for (const Eigen::Vector2d& pixel : live) {
    const int x = static_cast<int>(std::lround(pixel.x()));
    const int y = static_cast<int>(std::lround(pixel.y()));
    if (x >= 0 && y >= 0 && x < image.cols && y < image.rows) occupancy.Take(x, y);
  }
  for (const Corner& corner : FindCorners(image, mask, options.min_relative_score)) {
    if (!occupancy.IsFree(corner.x, corner.y)) continue;
    occupancy.Take(corner.x, corner.y);
    features.emplace_back(corner.x, corner.y);
    if (--missing == 0) break;
  }
  return features;
}

}  // namespace scenecalib
