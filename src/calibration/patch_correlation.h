#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <optional>

namespace scenecalib {

/// Where a template fits best inside a window.
struct CorrelationPeak {
  Eigen::Vector2d shift_px = Eigen::Vector2d::Zero();  ///< from the centred position, sub-pixel
  double ncc = 0.0;                                    ///< at the best whole pixel, [-1, 1]
  double width_px = 0.0;     ///< diameter of the peak's area above half height
  double second_ncc = -1.0;  ///< best other local maximum, outside the peak
};

/// Normalised cross-correlation of `patch` with every position in `window`, both 8-bit grey and
/// made alike by histogram equalisation; the sub-pixel position is the centre of mass of the
/// correlation about the peak (III-E). The window is larger than the patch by an even number of
/// pixels. Only pixels with mask 255 count. None when the peak lies on the border of the search or
/// nothing varies.
std::optional<CorrelationPeak> Correlate(const cv::Mat& patch, const cv::Mat& mask,
                                         const cv::Mat& window);

}  // namespace scenecalib
