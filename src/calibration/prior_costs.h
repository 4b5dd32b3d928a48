#pragma once

#include <ceres/sized_cost_function.h>

#include <vector>

#include "scenecalib/calibration/calibration_problem.h"

namespace scenecalib {

/// (value - mean) / sigma of a small block, component by component.
class DiagonalPriorCost : public ceres::CostFunction {
 public:
  DiagonalPriorCost(const Eigen::VectorXd& mean, const Eigen::VectorXd& sigma)
      : mean_(mean), sigma_(sigma) {
    set_num_residuals(static_cast<int>(mean.size()));
    mutable_parameter_block_sizes()->push_back(static_cast<int>(mean.size()));
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const int n = num_residuals();
    for (int i = 0; i < n; ++i) residuals[i] = (parameters[0][i] - mean_[i]) / sigma_[i];
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) jacobians[0][n * i + j] = i == j ? 1.0 / sigma_[i] : 0.0;
    }
    return true;
  }

 private:
  Eigen::VectorXd mean_;
  Eigen::VectorXd sigma_;
};

/// (next - previous) / sigma of two neighbouring knots: a random walk.
class WalkCost : public ceres::SizedCostFunction<6, 6, 6> {
 public:
  explicit WalkCost(const Vector6d& sigma) : inverse_sigma_(sigma.cwiseInverse()) {}

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    using RowMajor66 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
    const Eigen::Map<const Vector6d> previous(parameters[0]);
    const Eigen::Map<const Vector6d> next(parameters[1]);
    Eigen::Map<Vector6d> mapped(residuals);
    mapped = inverse_sigma_.cwiseProduct(next - previous);
    if (jacobians == nullptr) return true;
    const RowMajor66 weight = inverse_sigma_.asDiagonal();
    for (int i = 0; i < 2; ++i) {
      if (jacobians[i] == nullptr) continue;
      Eigen::Map<RowMajor66> mapped_jacobian(jacobians[i]);
      mapped_jacobian = i == 0 ? RowMajor66(-weight) : weight;
    }
    return true;
  }

 private:
  Vector6d inverse_sigma_;
};

/// The mean of all knots over sigma: keeps a constant correction, which is indistinguishable from
/// the extrinsics, at zero.
class ZeroMeanCost : public ceres::CostFunction {
 public:
  ZeroMeanCost(int num_knots, const Vector6d& sigma)
      : weight_((sigma * static_cast<double>(num_knots)).cwiseInverse()) {
    set_num_residuals(6);
    mutable_parameter_block_sizes()->assign(num_knots, 6);
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    using RowMajor66 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
    const auto num_knots = parameter_block_sizes().size();
    Vector6d sum = Vector6d::Zero();
    for (std::size_t i = 0; i < num_knots; ++i) {
      sum += Eigen::Map<const Vector6d>(parameters[i]);
    }
    Eigen::Map<Vector6d> mapped(residuals);
    mapped = weight_.cwiseProduct(sum);
    if (jacobians == nullptr) return true;
    const RowMajor66 weight = weight_.asDiagonal();
    for (std::size_t i = 0; i < num_knots; ++i) {
      if (jacobians[i] == nullptr) continue;
      Eigen::Map<RowMajor66> mapped_jacobian(jacobians[i]);
      mapped_jacobian = weight;
    }
    return true;
  }

 private:
  Vector6d weight_;
};

}  // namespace scenecalib
