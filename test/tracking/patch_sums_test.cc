#include "../../src/tracking/patch_sums.h"

#include <gtest/gtest.h>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr int kNumPixels = 121;

/// Grey values, weights and a design of random numbers; without weight behind the last pixel, where
/// the values are no part of the patch.
struct Patch {
  explicit Patch(int num_columns)
      : values(PaddedCount(kNumPixels)),
        weights(Eigen::VectorXf::Zero(PaddedCount(kNumPixels))),
        design(PaddedCount(kNumPixels), num_columns) {
    Random random(3);
    for (Eigen::Index i = 0; i < values.size(); ++i) {
      values[i] = static_cast<float>(random.Uniform(0.0, 255.0));
      for (int c = 0; c < num_columns; ++c) {
        design(i, c) = static_cast<float>(random.Uniform(-20.0, 20.0));
      }
      if (i < kNumPixels) weights[i] = static_cast<float>(random.Uniform(0.1, 1.0));
    }
    weights /= weights.sum();
  }

  Eigen::VectorXf values;
  Eigen::VectorXf weights;
  Eigen::MatrixXf design;
};

TEST(PatchSums, PadToWholeRegisters) {
  EXPECT_EQ(PaddedCount(121), 128);
  EXPECT_EQ(PaddedCount(128), 128);
  EXPECT_EQ(PaddedCount(1), 8);
}

class PatchSumsOf : public ::testing::TestWithParam<int> {};

TEST_P(PatchSumsOf, AreTheNormalEquations) {
  const Patch patch(GetParam());
  const Eigen::MatrixXd design = patch.design.cast<double>();
  const Eigen::MatrixXd expected_weighted = patch.weights.cast<double>().asDiagonal() * design;
  const Eigen::MatrixXf weighted = Weighted(patch.design, patch.weights);
  EXPECT_LT((weighted.cast<double>() - expected_weighted).norm(), 1e-6 * expected_weighted.norm());
  const Eigen::MatrixXd normal = design.transpose() * expected_weighted;
  EXPECT_LT((NormalOf(patch.design, weighted) - normal).norm(), 1e-6 * normal.norm());

  Eigen::VectorXd products(GetParam());
  SumProducts(weighted, patch.values.data(), products.data());
  const Eigen::VectorXd expected = expected_weighted.transpose() * patch.values.cast<double>();
  EXPECT_LT((products - expected).norm(), 1e-5 * expected.norm());
}

TEST_P(PatchSumsOf, CarryUnitVariancesThroughTwoCombinations) {
  const Patch patch(GetParam());
  const Eigen::MatrixXf weighted = Weighted(patch.design, patch.weights);
  Eigen::MatrixXf combination(GetParam(), 2);
  for (int c = 0; c < GetParam(); ++c) {
    combination.row(c) << 0.2F * static_cast<float>(c + 1), 1.0F - 0.3F * static_cast<float>(c);
  }
  const Eigen::MatrixXd combined = weighted.cast<double>() * combination.cast<double>();
  const Eigen::Matrix2d expected = combined.transpose() * combined;
  EXPECT_LT((SandwichOf(weighted, combination) - expected).norm(), 1e-5 * expected.norm());
}

TEST_P(PatchSumsOf, TellWhatAModelLeaves) {
  const Patch patch(GetParam());
  Eigen::VectorXf solution(GetParam());
  for (int c = 0; c < GetParam(); ++c) solution[c] = 0.3F * static_cast<float>(c + 1);
  const Eigen::VectorXd residual = (patch.values - patch.design * solution).cast<double>();
  const double expected = patch.weights.cast<double>().dot(residual.cwiseAbs2());
  EXPECT_NEAR(ResidualSquare(patch.values, patch.design, solution.data(), patch.weights.data()),
              expected, 1e-5 * expected);
}

INSTANTIATE_TEST_SUITE_P(ShiftAndAffine, PatchSumsOf, ::testing::Values(4, 8));

TEST(PatchSums, MomentsAreOfTheWeightedPixels) {
  const Patch patch(4);
  const Eigen::VectorXf pattern = patch.weights.cwiseProduct(patch.design.col(0));
  const WeightedMoments moments = MomentsOf(patch.values, patch.weights.data(), pattern.data());
  const Eigen::VectorXd values = patch.values.cast<double>();
  const Eigen::VectorXd weights = patch.weights.cast<double>();
  const double mean = weights.dot(values);
  EXPECT_NEAR(moments.mean, mean, 1e-4);
  EXPECT_NEAR(moments.variance, weights.dot((values.array() - mean).matrix().cwiseAbs2()), 0.05);
  EXPECT_NEAR(moments.product, pattern.cast<double>().dot(values), 1e-3);
}

}  // namespace
}  // namespace scenecalib
