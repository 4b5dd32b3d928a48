#include "patch_sums.h"

#include <cstring>

#include "vector_clones.h"

namespace scenecalib {
namespace {

constexpr Eigen::Index kLanes = 8;
/// Eight pixels: one register with AVX2, two without.
using Lanes = float __attribute__((vector_size(kLanes * sizeof(float))));

// Macros and not functions: what passes vectors cannot be shared between the clones.
#define SCENECALIB_LOAD(name, from) \
  Lanes name;                       \
  std::memcpy(&(name), (from), sizeof(Lanes))
#define SCENECALIB_STORE(name, to) std::memcpy((to), &(name), sizeof(Lanes))

double SumOf(const float* lanes) {
  double sum = 0.0;
  for (int i = 0; i < kLanes; ++i) sum += static_cast<double>(lanes[i]);
  return sum;
}

SCENECALIB_VECTOR_CLONES
void SumFour(const float* columns, Eigen::Index num_rows, const float* values, float* sums) {
  Lanes sum[4] = {};
  for (Eigen::Index i = 0; i < num_rows; i += kLanes) {
    SCENECALIB_LOAD(value, values + i);
#pragma GCC unroll 4
    for (int c = 0; c < 4; ++c) {
      SCENECALIB_LOAD(column, columns + c * num_rows + i);
      sum[c] += column * value;
    }
  }
  std::memcpy(sums, sum, sizeof(sum));
}

SCENECALIB_VECTOR_CLONES
void SumEight(const float* columns, Eigen::Index num_rows, const float* values, float* sums) {
  Lanes sum[8] = {};
  for (Eigen::Index i = 0; i < num_rows; i += kLanes) {
    SCENECALIB_LOAD(value, values + i);
#pragma GCC unroll 8
    for (int c = 0; c < 8; ++c) {
      SCENECALIB_LOAD(column, columns + c * num_rows + i);
      sum[c] += column * value;
    }
  }
  std::memcpy(sums, sum, sizeof(sum));
}

SCENECALIB_VECTOR_CLONES
void Weigh(const float* column, const float* weights, Eigen::Index num_rows, float* weighted) {
  for (Eigen::Index i = 0; i < num_rows; i += kLanes) {
    SCENECALIB_LOAD(value, column + i);
    SCENECALIB_LOAD(weight, weights + i);
    value *= weight;
    SCENECALIB_STORE(value, weighted + i);
  }
}

SCENECALIB_VECTOR_CLONES
void SumMeanAndProduct(const float* values, const float* weights, const float* pattern,
                       Eigen::Index num_rows, float* sums) {
  Lanes mean = {};
  Lanes product = {};
  for (Eigen::Index i = 0; i < num_rows; i += kLanes) {
    SCENECALIB_LOAD(value, values + i);
    SCENECALIB_LOAD(weight, weights + i);
    SCENECALIB_LOAD(other, pattern + i);
    mean += weight * value;
    product += other * value;
  }
  SCENECALIB_STORE(mean, sums);
  SCENECALIB_STORE(product, sums + kLanes);
}

SCENECALIB_VECTOR_CLONES
void SumVariance(const float* values, const float* weights, float mean, Eigen::Index num_rows,
                 float* sums) {
  Lanes variance = {};
  for (Eigen::Index i = 0; i < num_rows; i += kLanes) {
    SCENECALIB_LOAD(value, values + i);
    SCENECALIB_LOAD(weight, weights + i);
    value -= mean;
    variance += weight * value * value;
  }
  SCENECALIB_STORE(variance, sums);
}

SCENECALIB_VECTOR_CLONES
void SumResidualSquare(const float* values, const float* design, const float* solution,
                       Eigen::Index num_columns, const float* weights, Eigen::Index num_rows,
                       float* sums) {
  Lanes square = {};
  for (Eigen::Index i = 0; i < num_rows; i += kLanes) {
    SCENECALIB_LOAD(residual, values + i);
    SCENECALIB_LOAD(weight, weights + i);
    for (Eigen::Index c = 0; c < num_columns; ++c) {
      SCENECALIB_LOAD(column, design + c * num_rows + i);
      residual -= column * solution[c];
    }
    square += weight * residual * residual;
  }
  SCENECALIB_STORE(square, sums);
}

}  // namespace

Eigen::Index PaddedCount(Eigen::Index num_pixels) {
  return (num_pixels + kLanes - 1) / kLanes * kLanes;
}

void SumProducts(const Eigen::MatrixXf& columns, const float* values, double* products) {
  float sums[8 * kLanes];
  const Eigen::Index n = columns.cols();
  (n == 4 ? SumFour : SumEight)(columns.data(), columns.rows(), values, sums);
  for (Eigen::Index c = 0; c < n; ++c) products[c] = SumOf(sums + c * kLanes);
}

PatchGram GramOf(const Eigen::MatrixXf& design, const Eigen::VectorXf& weights) {
  const Eigen::Index n = design.cols();
  PatchGram gram;
  gram.weighted.resize(design.rows(), n);
  gram.normal.resize(n, n);
  gram.meat.resize(n, n);
  for (Eigen::Index c = 0; c < n; ++c) {
    Weigh(design.col(c).data(), weights.data(), design.rows(), gram.weighted.col(c).data());
  }
  for (Eigen::Index c = 0; c < n; ++c) {
    SumProducts(gram.weighted, design.col(c).data(), gram.normal.col(c).data());
    SumProducts(gram.weighted, gram.weighted.col(c).data(), gram.meat.col(c).data());
  }
  return gram;
}

WeightedMoments MomentsOf(const Eigen::VectorXf& values, const float* weights,
                          const float* weighted_pattern) {
  float sums[2 * kLanes];
  SumMeanAndProduct(values.data(), weights, weighted_pattern, values.size(), sums);
  WeightedMoments moments;
  moments.mean = static_cast<float>(SumOf(sums));
  moments.product = static_cast<float>(SumOf(sums + kLanes));
  SumVariance(values.data(), weights, moments.mean, values.size(), sums);
  moments.variance = static_cast<float>(SumOf(sums));
  return moments;
}

float ResidualSquare(const Eigen::VectorXf& values, const Eigen::MatrixXf& design,
                     const float* solution, const float* weights) {
  float sums[kLanes];
  SumResidualSquare(values.data(), design.data(), solution, design.cols(), weights, values.size(),
                    sums);
  return static_cast<float>(SumOf(sums));
}

}  // namespace scenecalib
