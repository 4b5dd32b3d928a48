#include "term_group_cost.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

namespace scenecalib {
namespace {

/// Pivots of the information matrix below this share of the largest one belong to directions that
/// the group says nothing about.
constexpr double kMinPivotShare = 1e-14;

}  // namespace

TermGroupCost::TermGroupCost(const TermGroup* group) : group_(group) {
  set_num_residuals(group->num_columns() + 1);
  *mutable_parameter_block_sizes() =
      std::vector<int32_t>(group->block_sizes().begin(), group->block_sizes().end());
}

bool TermGroupCost::UpdateEquations(double const* const* parameters) const {
  std::vector<double> here;
  here.reserve(group_->num_columns());
  for (std::size_t b = 0; b < group_->block_sizes().size(); ++b) {
    here.insert(here.end(), parameters[b], parameters[b] + group_->block_sizes()[b]);
  }
  if (here == last_parameters_) return true;
  last_parameters_.clear();
  has_factor_ = false;
  if (!group_->Evaluate(parameters, true, &last_equations_)) return false;
  last_parameters_ = std::move(here);
  return true;
}

void TermGroupCost::UpdateFactor() const {
  if (has_factor_) return;
  has_factor_ = true;
  const int n = group_->num_columns();
  // H = P^T L D L^T P, so that e = D^-1/2 L^-1 P g and de^T = P^T L D^1/2.
  const Eigen::LDLT<Eigen::MatrixXd> factor(last_equations_.information);
  last_root_ = factor.matrixL();
  Eigen::VectorXd reduced = factor.transpositionsP() * last_equations_.gradient;
  factor.matrixL().solveInPlace(reduced);
  const Eigen::VectorXd pivots = factor.vectorD();
  const double min_pivot = kMinPivotShare * std::max(0.0, pivots.maxCoeff());
  last_residual_ = Eigen::VectorXd::Zero(n + 1);
  for (int i = 0; i < n; ++i) {
    const double scale = pivots[i] > min_pivot ? std::sqrt(pivots[i]) : 0.0;
    last_root_.col(i) *= scale;
    last_residual_[i] = scale > 0.0 ? reduced[i] / scale : 0.0;
  }
  last_root_ = factor.transpositionsP().transpose() * last_root_;
  last_residual_[n] =
      std::sqrt(std::max(0.0, last_equations_.cost - last_residual_.head(n).squaredNorm()));
}

void TermGroupCost::Prepare(bool with_jacobians) const {
  if (UpdateEquations(group_->blocks().data()) && with_jacobians) UpdateFactor();
}

bool TermGroupCost::Evaluate(double const* const* parameters, double* residuals,
                             double** jacobians) const {
  if (!UpdateEquations(parameters)) return false;
  const int n = group_->num_columns();
  Eigen::Map<Eigen::VectorXd> mapped(residuals, n + 1);
  mapped.setZero();
  mapped[n] = std::sqrt(last_equations_.cost);
  if (jacobians == nullptr) return true;
  UpdateFactor();
  mapped = last_residual_;
  int column = 0;
  for (std::size_t b = 0; b < group_->block_sizes().size(); ++b) {
    const int size = group_->block_sizes()[b];
    if (jacobians[b] != nullptr) {
      using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
      Eigen::Map<RowMajor> jacobian(jacobians[b], n + 1, size);
      jacobian.topRows(n) = last_root_.middleRows(column, size).transpose();
      jacobian.row(n).setZero();
    }
    column += size;
  }
  return true;
}

void GroupPreparation::PrepareForEvaluation(bool evaluate_jacobians,
                                            bool /*new_evaluation_point*/) {
  tbb::parallel_for(std::size_t{0}, costs.size(),
                    [&](std::size_t i) { costs[i]->Prepare(evaluate_jacobians); });
}

}  // namespace scenecalib
