#include "pixel_grid.h"

#include <utility>

#include "pixel_kernels.h"
#include "scenecalib/tracking/pixel_reading.h"
#include "vector_dispatch.h"

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

PixelGrid EmptyGrid(int edge) {
  return {PixelGrid::Matrix(edge, edge), PixelGrid::Matrix(edge, edge),
          PixelGrid::Matrix(edge, edge)};
}

/// Of each of `count` pixels the four (the two) from there on, weighted.
SCENECALIB_ALWAYS_INLINE void WeighFourPixelsBody(const uchar* pixels, const float* weights,
                                                  int count, float* sums) {
  const float a = weights[0], b = weights[1], c = weights[2], d = weights[3];
  for (int x = 0; x < count; ++x) {
    sums[x] = a * static_cast<float>(pixels[x]) + b * static_cast<float>(pixels[x + 1]) +
              c * static_cast<float>(pixels[x + 2]) + d * static_cast<float>(pixels[x + 3]);
  }
}

SCENECALIB_ALWAYS_INLINE void WeighTwoPixelsBody(const uchar* pixels, const float* weights,
                                                 int count, float* sums) {
  const float a = weights[0], b = weights[1];
  for (int x = 0; x < count; ++x) {
    sums[x] = a * static_cast<float>(pixels[x]) + b * static_cast<float>(pixels[x + 1]);
  }
}

/// Of each of `count` values the `taps` that lie a row apart from there on, weighted.
SCENECALIB_ALWAYS_INLINE void WeighRowsBody(const float* values, const float* weights, int taps,
                                            int count, int row, float* sums) {
  for (int i = 0; i < count; ++i) sums[i] = weights[0] * values[i];
  for (int k = 1; k < taps; ++k) {
    const float* shifted = values + k * row;
    for (int i = 0; i < count; ++i) sums[i] += weights[k] * shifted[i];
  }
}

SCENECALIB_DISPATCHED(WeighFourPixels, WeighFourPixelsBody,
                      (const uchar* pixels, const float* weights, int count, float* sums),
                      (pixels, weights, count, sums))
SCENECALIB_DISPATCHED(WeighTwoPixels, WeighTwoPixelsBody,
                      (const uchar* pixels, const float* weights, int count, float* sums),
                      (pixels, weights, count, sums))
SCENECALIB_DISPATCHED(WeighRows, WeighRowsBody,
                      (const float* values, const float* weights, int taps, int count, int row,
                       float* sums),
                      (values, weights, taps, count, row, sums))

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
  float across[4], across_slope[4], down[4], down_slope[4];
  SplineWeights(first.fraction_x, across);
  SplineWeights(first.fraction_y, down);
  SplineDerivatives(first.fraction_x, across_slope);
  SplineDerivatives(first.fraction_y, down_slope);
  PixelGrid::Matrix smoothed(edge + 3, edge);
  PixelGrid::Matrix sloped(edge + 3, edge);
  for (int y = 0; y < edge + 3; ++y) {
    WeighFourPixels(first.corner + y * image.step[0], across, edge, smoothed.row(y).data());
    WeighFourPixels(first.corner + y * image.step[0], across_slope, edge, sloped.row(y).data());
  }
  PixelGrid grid = EmptyGrid(edge);
  WeighRows(smoothed.data(), down, 4, edge * edge, edge, grid.value.data());
  WeighRows(sloped.data(), down, 4, edge * edge, edge, grid.gradient_x.data());
  WeighRows(smoothed.data(), down_slope, 4, edge * edge, edge, grid.gradient_y.data());
  return grid;
}

PixelGrid ReadGridBilinear(const cv::Mat& image, const Eigen::Vector2d& center_px, int radius_px) {
  const int edge = 2 * radius_px + 3;
  const Cell first = Locate(image, static_cast<float>(center_px.x() - radius_px - 1),
                            static_cast<float>(center_px.y() - radius_px - 1));
  const uchar* corner = first.corner + image.step[0] + 1;  // of the cell's middle four pixels
  const float across[2] = {1.0F - first.fraction_x, first.fraction_x};
  const float down[2] = {1.0F - first.fraction_y, first.fraction_y};
  PixelGrid::Matrix mixed(edge + 1, edge);
  for (int y = 0; y < edge + 1; ++y) {
    WeighTwoPixels(corner + y * image.step[0], across, edge, mixed.row(y).data());
  }
  PixelGrid::Matrix value(edge, edge);
  WeighRows(mixed.data(), down, 2, edge * edge, edge, value.data());
  const int inner = edge - 2;
  return {value.block(1, 1, inner, inner),
          0.5F * (value.block(1, 2, inner, inner) - value.block(1, 0, inner, inner)),
          0.5F * (value.block(2, 1, inner, inner) - value.block(0, 1, inner, inner))};
}

void Blur(const Eigen::Vector2d& sigma_px, int margin, PixelGrid* grid) {
  const Eigen::VectorXf across = GaussianWeights(sigma_px.x(), margin);
  const Eigen::VectorXf down = GaussianWeights(sigma_px.y(), margin);
  for (PixelGrid::Matrix* channel : {&grid->value, &grid->gradient_x, &grid->gradient_y}) {
    const Eigen::Index inner = channel->rows() - 2 * margin;
    PixelGrid::Matrix rows;
    if (sigma_px.y() > 0.0) {
      rows = down[0] * channel->topRows(inner);
      for (int i = 1; i <= 2 * margin; ++i) rows += down[i] * channel->middleRows(i, inner);
    } else {
      rows = channel->middleRows(margin, inner);
    }
    if (sigma_px.x() > 0.0) {
      PixelGrid::Matrix blurred = across[0] * rows.leftCols(inner);
      for (int i = 1; i <= 2 * margin; ++i) blurred += across[i] * rows.middleCols(i, inner);
      *channel = std::move(blurred);
    } else {
      *channel = rows.middleCols(margin, inner);
    }
  }
}

}  // namespace scenecalib
