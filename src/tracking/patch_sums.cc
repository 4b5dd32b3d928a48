#include "patch_sums.h"

#include <cstring>

#include "vector_dispatch.h"

namespace scenecalib {
namespace {

constexpr Eigen::Index kLanes = 8;
/// Eight pixels: one register with AVX2, two without.
using Lanes = float __attribute__((vector_size(kLanes * sizeof(float))));

#define SCENECALIB_LOAD(name, from) \
  Lanes name;                       \
  std::memcpy(&(name), (from), sizeof(Lanes))
#define SCENECALIB_STORE(name, to) std::memcpy((to), &(name), sizeof(Lanes))

double SumOf(const float* lanes) {
  double sum = 0.0;
  for (int i = 0; i < kLanes; ++i) sum += static_cast<double>(lanes[i]);
  return sum;
}

template <int kColumns>
SCENECALIB_ALWAYS_INLINE void SumColumnsBody(const float* columns, Eigen::Index num_rows,
                                             const float* values, float* sums) {
  Lanes sum[kColumns];
#pragma GCC unroll 8
  for (Lanes& lanes : sum) lanes = Lanes{};
  for (Eigen::Index i = 0; i < num_rows; i += kLanes) {
    SCENECALIB_LOAD(value, values + i);
#pragma GCC unroll 8
    for (int c = 0; c < kColumns; ++c) {
      SCENECALIB_LOAD(column, columns + c * num_rows + i);
      sum[c] += column * value;
    }
  }
  std::memcpy(sums, sum, sizeof(sum));
}

SCENECALIB_ALWAYS_INLINE void WeighBody(const float* column, const float* weights,
                                        Eigen::Index num_rows, float* weighted) {
  for (Eigen::Index i = 0; i < num_rows; i += kLanes) {
    SCENECALIB_LOAD(value, column + i);
    SCENECALIB_LOAD(weight, weights + i);
    value *= weight;
    SCENECALIB_STORE(value, weighted + i);
  }
}

SCENECALIB_ALWAYS_INLINE void SumMeanAndProductBody(const float* values, const float* weights,
                                                    const float* pattern, Eigen::Index num_rows,
                                                    float* sums) {
  Lanes mean{};
  Lanes product{};
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

SCENECALIB_ALWAYS_INLINE void SumVarianceBody(const float* values, const float* weights, float mean,
                                              Eigen::Index num_rows, float* sums) {
  Lanes variance{};
  for (Eigen::Index i = 0; i < num_rows; i += kLanes) {
    SCENECALIB_LOAD(value, values + i);
    SCENECALIB_LOAD(weight, weights + i);
    value -= mean;
    variance += weight * value * value;
  }
  SCENECALIB_STORE(variance, sums);
}

SCENECALIB_ALWAYS_INLINE void SumResidualSquareBody(const float* values, const float* design,
                                                    const float* solution, Eigen::Index num_columns,
                                                    const float* weights, Eigen::Index num_rows,
                                                    float* sums) {
  Lanes square{};
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

/// Of two combinations of the columns: the first's square, their product, the second's square.
SCENECALIB_ALWAYS_INLINE void SumCombinationSquaresBody(const float* columns,
                                                        Eigen::Index num_columns,
                                                        const float* first, const float* second,
                                                        Eigen::Index num_rows, float* sums) {
  Lanes squares[3] = {Lanes{}, Lanes{}, Lanes{}};
  for (Eigen::Index i = 0; i < num_rows; i += kLanes) {
    Lanes a{};
    Lanes b{};
    for (Eigen::Index c = 0; c < num_columns; ++c) {
      SCENECALIB_LOAD(column, columns + c * num_rows + i);
      a += column * first[c];
      b += column * second[c];
    }
    squares[0] += a * a;
    squares[1] += a * b;
    squares[2] += b * b;
  }
  std::memcpy(sums, squares, sizeof(squares));
}

SCENECALIB_DISPATCHED(SumFour, SumColumnsBody<4>,
                      (const float* columns, Eigen::Index num_rows, const float* values,
                       float* sums),
                      (columns, num_rows, values, sums))
SCENECALIB_DISPATCHED(SumEight, SumColumnsBody<8>,
                      (const float* columns, Eigen::Index num_rows, const float* values,
                       float* sums),
                      (columns, num_rows, values, sums))
SCENECALIB_DISPATCHED(Weigh, WeighBody,
                      (const float* column, const float* weights, Eigen::Index num_rows,
                       float* weighted),
                      (column, weights, num_rows, weighted))
SCENECALIB_DISPATCHED(SumMeanAndProduct, SumMeanAndProductBody,
                      (const float* values, const float* weights, const float* pattern,
                       Eigen::Index num_rows, float* sums),
                      (values, weights, pattern, num_rows, sums))
SCENECALIB_DISPATCHED(SumVariance, SumVarianceBody,
                      (const float* values, const float* weights, float mean, Eigen::Index num_rows,
                       float* sums),
                      (values, weights, mean, num_rows, sums))
SCENECALIB_DISPATCHED(SumResidualSquare, SumResidualSquareBody,
                      (const float* values, const float* design, const float* solution,
                       Eigen::Index num_columns, const float* weights, Eigen::Index num_rows,
                       float* sums),
                      (values, design, solution, num_columns, weights, num_rows, sums))
SCENECALIB_DISPATCHED(SumCombinationSquares, SumCombinationSquaresBody,
                      (const float* columns, Eigen::Index num_columns, const float* first,
                       const float* second, Eigen::Index num_rows, float* sums),
                      (columns, num_columns, first, second, num_rows, sums))

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

Eigen::MatrixXf Weighted(const Eigen::MatrixXf& design, const Eigen::VectorXf& weights) {
  Eigen::MatrixXf weighted(design.rows(), design.cols());
  for (Eigen::Index c = 0; c < design.cols(); ++c) {
    Weigh(design.col(c).data(), weights.data(), design.rows(), weighted.col(c).data());
  }
  return weighted;
}

PatchMatrix NormalOf(const Eigen::MatrixXf& design, const Eigen::MatrixXf& weighted) {
  const Eigen::Index n = design.cols();
  const Eigen::Index num_rows = design.rows();
  PatchMatrix normal(n, n);
  float sums[8 * kLanes];
  for (Eigen::Index c = 0; c < n; ++c) {
    // Symmetric: of the later columns, those of the first four are known.
    const Eigen::Index first = c < 4 ? 0 : 4;
    (n - first == 4 ? SumFour : SumEight)(weighted.col(first).data(), num_rows,
                                          design.col(c).data(), sums);
    for (Eigen::Index r = first; r < n; ++r) normal(r, c) = SumOf(sums + (r - first) * kLanes);
  }
  if (n == 8) normal.topRightCorner<4, 4>() = normal.bottomLeftCorner<4, 4>().transpose();
  return normal;
}

Eigen::Matrix2d SandwichOf(const Eigen::MatrixXf& weighted,
                           const Eigen::Matrix<float, Eigen::Dynamic, 2, 0, 8, 2>& combination) {
  float sums[3 * kLanes];
  SumCombinationSquares(weighted.data(), weighted.cols(), combination.col(0).data(),
                        combination.col(1).data(), weighted.rows(), sums);
  Eigen::Matrix2d sandwich;
  sandwich << SumOf(sums), SumOf(sums + kLanes), SumOf(sums + kLanes), SumOf(sums + 2 * kLanes);
  return sandwich;
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
