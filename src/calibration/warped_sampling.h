#pragma once

#include <opencv2/core.hpp>

namespace scenecalib {

/// Reads a grey image at the mapped positions (x, y), beyond its border what the border has. Where
/// it `is_finer` than the map's grid, the mean of four places within a pixel of the grid keeps what
/// that cannot resolve out. Written out because OpenCV's own filters and warps round differently
/// for different numbers of threads.
cv::Mat1b SampleAt(const cv::Mat& source, const cv::Mat2f& map, bool is_finer);

}  // namespace scenecalib
