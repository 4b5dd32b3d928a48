#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>

namespace scenecalib {

/// Values and gradients of a square of pixels around a centre.
struct PixelGrid {
  using Matrix = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Matrix value, gradient_x, gradient_y;  ///< rows are y
};

/// Through the cubic B-spline kernel. The caller checks that the square can be read.
PixelGrid ReadGridSmoothed(const cv::Mat& image, const Eigen::Vector2d& center_px, int radius_px);

/// Bilinear; gradients over two pixels.
PixelGrid ReadGridBilinear(const cv::Mat& image, const Eigen::Vector2d& center_px, int radius_px);

/// The grid without its margin, blurred by Gaussians across and down.
void Blur(const Eigen::Vector2d& sigma_px, int margin, PixelGrid* grid);

}  // namespace scenecalib
