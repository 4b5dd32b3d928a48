#pragma once

#include <opencv2/core.hpp>

namespace scenecalib {

/// Grey value and gradient of an 8-bit image read through the cubic B-spline kernel. The pixel must
/// be at least 2 px inside the image.
struct SmoothedPixel {
  float value = 0.0F;
  float gradient_x = 0.0F;
  float gradient_y = 0.0F;
};
SmoothedPixel ReadSmoothed(const cv::Mat& image, double x_px, double y_px);

}  // namespace scenecalib
