#pragma once

#include <Eigen/Core>

namespace scenecalib {

/// Sums over the pixels of a patch. Pixels are summed eight side by side, so that every vector and
/// every column has PaddedCount(pixels) rows, of which those behind the last pixel carry no weight;
/// what the values are there does not matter as long as they are finite. All processors add in the
/// same order; those with FMA round less often.
Eigen::Index PaddedCount(Eigen::Index num_pixels);

/// columns^T values, of 4 or 8 columns.
void SumProducts(const Eigen::MatrixXf& columns, const float* values, double* products);

/// W design, of pixels x 4 or 8.
Eigen::MatrixXf Weighted(const Eigen::MatrixXf& design, const Eigen::VectorXf& weights);

/// Of 4 or 8 parameters.
using PatchMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 8, 8>;

/// design^T W design.
PatchMatrix NormalOf(const Eigen::MatrixXf& design, const Eigen::MatrixXf& weighted);

/// combination^T design^T W^2 design combination, of two combinations of the parameters.
Eigen::Matrix2d SandwichOf(const Eigen::MatrixXf& weighted,
                           const Eigen::Matrix<float, Eigen::Dynamic, 2, 0, 8, 2>& combination);

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
