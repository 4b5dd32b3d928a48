#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <vector>

#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// The buckets that features are spread over, row by row.
class BucketGrid {
 public:
  BucketGrid(const cv::Size& image_size, int bucket_px)
      : bucket_px_(bucket_px),
        columns_((image_size.width + bucket_px - 1) / bucket_px),
        rows_((image_size.height + bucket_px - 1) / bucket_px) {}

  std::size_t size() const { return static_cast<std::size_t>(columns_ * rows_); }
  /// Of a pixel inside the image.
  std::size_t At(int x, int y) const {
    return static_cast<std::size_t>((y / bucket_px_) * columns_ + x / bucket_px_);
  }

 private:
  int bucket_px_;
  int columns_;
  int rows_;
};

/// New corners (Shi-Tomasi: smaller eigenvalue of the structure tensor) in an 8-bit grey image,
/// spread over buckets, at least min_distance_px from `live` features and from each other, only
/// where `mask` (same size, 8-bit) is not zero; together with the live ones at most max_features.
/// `share_of_bucket` (empty: all 1) scales what each bucket of a BucketGrid may hold.
/// Strongest first; whole pixels, because any point of a patch serves as well as any other.
std::vector<Eigen::Vector2d> DetectFeatures(const cv::Mat& image, const cv::Mat& mask,
                                            const std::vector<Eigen::Vector2d>& live,
                                            const DetectionOptions& options,
                                            const std::vector<double>& share_of_bucket = {});

}  // namespace scenecalib
