#pragma once

#include <Eigen/Core>

namespace scenecalib {

/// Sums over the pixels of a patch. Pixels are summed eight side by side, so that every vector and
/// every column has PaddedCount(pixels) rows, of which those behind the last pixel carry no weight;
/// what the values are there does not matter as long as they are finite. All processors add in the
/// same order.
Eigen::Index PaddedCount(Eigen::Index num_pixels);

/// columns^T values, of 4 or 8 columns.
void SumProducts(const Eigen::MatrixXf& columns, const float* values, double* products);

/// The weighted least squares of a patch: design is pixels x 4 or 8.
struct PatchGram {
  Eigen::MatrixXf weighted;  ///< W design
  Eigen::MatrixXd normal;    ///< design^T W design
  Eigen::MatrixXd meat;      ///< design^T W^2 design
};
PatchGram GramOf(const Eigen::MatrixXf& design, const Eigen::VectorXf& weights);

/// Of values under weights that sum up to 1.
struct WeightedMoments {
  float mean = 0.0F;
  float variance = 0.0F;
  float product = 0.0F;  ///< with the pattern's values, which are weighted already
};
WeightedMoments MomentsOf(const Eigen::VectorXf& values, const float* weights,
                          const float* weighted_pattern);

/// Weighted square of values - design * solution.
float ResidualSquare(const Eigen::VectorXf& values, const Eigen::MatrixXf& design,
                     const float* solution, const float* weights);

}  // namespace scenecalib
