#pragma once

#include <ceres/cost_function.h>
#include <ceres/evaluation_callback.h>

#include <Eigen/Core>
#include <vector>

#include "term_group.h"

namespace scenecalib {

/// A group as Ceres sees it. Of n parameters there are n residuals e = L^-1 g with the Jacobian
/// L^T, where L L^T is the information matrix, and one more that brings the sum of squares to the
/// robust cost: the same normal equations, gradient and cost as the terms have, at a cost to the
/// solver that does not grow with their number.
class TermGroupCost : public ceres::CostFunction {
 public:
  /// The group must outlive the cost.
  explicit TermGroupCost(const TermGroup* group);

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override;

  /// Prepares Evaluate() at the present values of the group's blocks.
  void Prepare(bool with_jacobians) const;

 private:
  bool UpdateEquations(double const* const* parameters) const;
  void UpdateFactor() const;

  const TermGroup* group_;
  /// The last equations and where they hold: the solver asks for the cost at a step's end first,
  /// and then, as a step is mostly taken, for the derivatives there. One thread at a time.
  mutable std::vector<double> last_parameters_;
  mutable GroupEquations last_equations_;
  /// Of the last equations, once somebody asked for it.
  mutable bool has_factor_ = false;
  mutable Eigen::MatrixXd last_root_;
  mutable Eigen::VectorXd last_residual_;
};

/// Prepares all groups of a problem side by side whenever the solver gets to a new point. Ceres by
/// itself would either take one after the other or, with threads, add them up in an order that
/// changes from run to run.
class GroupPreparation : public ceres::EvaluationCallback {
 public:
  void PrepareForEvaluation(bool evaluate_jacobians, bool new_evaluation_point) override;

  std::vector<const TermGroupCost*> costs;  ///< which must outlive this
};

}  // namespace scenecalib
