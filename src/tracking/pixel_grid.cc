#include "pixel_grid.h"

#include <utility>

#include "pixel_kernels.h"
#include "scenecalib/tracking/pixel_reading.h"

namespace scenecalib {
namespace {

/// Weights of a Gaussian at whole pixels from -margin to margin.
Eigen::VectorXf GaussianWeights(double sigma_px, int margin) {
  Eigen::VectorXf weights = Eigen::VectorXf::Zero(2 * margin + 1);
  for (int i = -margin; i <= margin; ++i) {
    const double u = sigma_px > 0.0 ? i / sigma_px : (i == 0 ? 0.0 : 1e3);
    weights[i + margin] = static_cast<float>(std::exp(-0.5 * u * u));
  }
  return weights / weights.sum();
}

}  // namespace

SmoothedPixel ReadSmoothed(const cv::Mat& image, double x_px, double y_px) {
  const PixelGrid grid = ReadGridSmoothed(image, {x_px, y_px}, 0);
  return {grid.value(0, 0), grid.gradient_x(0, 0), grid.gradient_y(0, 0)};
}

PixelGrid ReadGridSmoothed(const cv::Mat& image, const Eigen::Vector2d& center_px, int radius_px) {
  const int edge = 2 * radius_px + 1;
  // All pixels of the grid have the same fraction, so that the kernel is separable: first along
  // the rows, then down the columns.
  const Cell first = Locate(image, static_cast<float>(center_px.x() - radius_px),
                            static_cast<float>(center_px.y() - radius_px));
  Eigen::Vector4f across, across_slope, down, down_slope;
  SplineWeights(first.fraction_x, across.data());
  SplineWeights(first.fraction_y, down.data());
  SplineDerivatives(first.fraction_x, across_slope.data());
  SplineDerivatives(first.fraction_y, down_slope.data());
  const int num_rows = edge + 3;
  const Eigen::Map<const Eigen::Matrix<uchar, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>, 0,
                   Eigen::OuterStride<>>
      raw(first.corner, num_rows, edge + 3,
          Eigen::OuterStride<>(static_cast<Eigen::Index>(image.step[0])));
  const Eigen::MatrixXf pixels = raw.cast<float>();
  Eigen::MatrixXf smoothed = Eigen::MatrixXf::Zero(num_rows, edge);
  Eigen::MatrixXf sloped = Eigen::MatrixXf::Zero(num_rows, edge);
  for (int k = 0; k < 4; ++k) {
    smoothed += across[k] * pixels.middleCols(k, edge);
    sloped += across_slope[k] * pixels.middleCols(k, edge);
  }
  PixelGrid grid{Eigen::MatrixXf::Zero(edge, edge), Eigen::MatrixXf::Zero(edge, edge),
                 Eigen::MatrixXf::Zero(edge, edge)};
  for (int k = 0; k < 4; ++k) {
    grid.value += down[k] * smoothed.middleRows(k, edge);
    grid.gradient_x += down[k] * sloped.middleRows(k, edge);
    grid.gradient_y += down_slope[k] * smoothed.middleRows(k, edge);
  }
  return grid;
}

PixelGrid ReadGridBilinear(const cv::Mat& image, const Eigen::Vector2d& center_px, int radius_px) {
  const int edge = 2 * radius_px + 3;
  const auto left = static_cast<float>(center_px.x() - radius_px - 1);
  const auto top = static_cast<float>(center_px.y() - radius_px - 1);
  Eigen::MatrixXf value(edge, edge);
  for (int column = 0; column < edge; ++column) {
    for (int row = 0; row < edge; ++row) {
      value(row, column) =
          Bilinear(Locate(image, left + static_cast<float>(column), top + static_cast<float>(row)),
                   image.step[0]);
    }
  }
  const int inner = edge - 2;
  return {value.block(1, 1, inner, inner),
          0.5F * (value.block(1, 2, inner, inner) - value.block(1, 0, inner, inner)),
          0.5F * (value.block(2, 1, inner, inner) - value.block(0, 1, inner, inner))};
}

void Blur(const Eigen::Vector2d& sigma_px, int margin, PixelGrid* grid) {
  const Eigen::VectorXf across = GaussianWeights(sigma_px.x(), margin);
  const Eigen::VectorXf down = GaussianWeights(sigma_px.y(), margin);
  for (Eigen::MatrixXf* channel : {&grid->value, &grid->gradient_x, &grid->gradient_y}) {
    const Eigen::Index inner = channel->rows() - 2 * margin;
    Eigen::MatrixXf rows = Eigen::MatrixXf::Zero(inner, channel->cols());
    for (int i = 0; i <= 2 * margin; ++i) rows += down[i] * channel->middleRows(i, inner);
    Eigen::MatrixXf blurred = Eigen::MatrixXf::Zero(inner, inner);
    for (int i = 0; i <= 2 * margin; ++i) blurred += across[i] * rows.middleCols(i, inner);
    *channel = std::move(blurred);
  }
}

}  // namespace scenecalib
