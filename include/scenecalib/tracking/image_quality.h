#pragma once

#include <map>
#include <opencv2/core.hpp>

#include "scenecalib/base/timestamp.h"

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

/// Share of an image's textured tiles in which the next image (same size) shows something else:
/// more than noise of `noise_levels`, a change of brightness or a shift of half a pixel makes. 0
/// where hardly anything is textured. Looks at about a thousand tiles, whatever the size of the
/// image.
double ChangedShare(const cv::Mat& image, const cv::Mat& next, double noise_levels);

/// Every image's sharpness as a share of the median of its neighbours' in time (four on either
/// side) and its own: what they show hardly differs, so well below 1 it is blurred by the
/// vehicle's or the camera's shaking. 1 where nothing can be said.
std::map<Timestamp, double> RelativeSharpness(const std::map<Timestamp, cv::Mat>& images);

}  // namespace scenecalib
