#pragma once

#include <ceres/sized_cost_function.h>

#include <vector>

#include "scenecalib/calibration/calibration_problem.h"

namespace scenecalib {

/// root_information * (value - mean) of a small block.
class PriorCost : public ceres::CostFunction {
 public:
  PriorCost(const Eigen::VectorXd& mean, const Eigen::MatrixXd& root_information)
      : mean_(mean), root_information_(root_information) {
    set_num_residuals(static_cast<int>(root_information.rows()));
    mutable_parameter_block_sizes()->push_back(static_cast<int>(mean.size()));
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    const Eigen::Map<const Eigen::VectorXd> value(parameters[0], mean_.size());
    Eigen::Map<Eigen::VectorXd>(residuals, num_residuals()) = root_information_ * (value - mean_);
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    Eigen::Map<RowMajor>(jacobians[0], num_residuals(), mean_.size()) = root_information_;
    return true;
  }

 private:
  Eigen::VectorXd mean_;
  Eigen::MatrixXd root_information_;
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

/// The mean of the knots over sigma: keeps a constant correction, which is indistinguishable from
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
