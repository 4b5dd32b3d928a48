#pragma once

#include <opencv2/core.hpp>

namespace scenecalib {

/// What an 8-bit grey image is worth, from a sample of its pixels.
struct ImageQuality {
  double mean = 0.0;          ///< grey levels
  double contrast = 0.0;      ///< standard deviation of the grey values
  double noise_levels = 0.0;  ///< standard deviation of the pixel noise
  double sharpness = 0.0;     ///< mean absolute gradient less what noise makes, grey levels / px
};

/// `mask` (same size, 8-bit, zero where not to look) may be empty. The noise is the median of the
/// second mixed difference, which planes and straight edges leave at zero (Immerkaer, CVIU 1996):
/// texture raises it, so it is rather an upper bound. About 20 000 pixels are read, on a fixed
/// grid.
ImageQuality MeasureImageQuality(const cv::Mat& image, const cv::Mat& mask);

}  // namespace scenecalib
