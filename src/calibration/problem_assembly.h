#pragma once

#include <ceres/problem.h>
#include <ceres/solver.h>

#include <memory>
#include <vector>

#include "scenecalib/calibration/calibration_problem.h"
#include "term_group_cost.h"

namespace scenecalib {

/// A Ceres problem over a CalibrationProblem's parameters, which must outlive it.
struct AssembledProblem {
  std::vector<std::unique_ptr<TermGroup>> groups;  ///< of CalibrationProblem::terms
  std::unique_ptr<GroupPreparation> preparation;   ///< outlives the problem
  std::unique_ptr<ceres::Problem> problem;
  std::vector<const TermGroupCost*> costs;  ///< of the groups; the problem owns them
  std::vector<ceres::ResidualBlockId> priors;
  std::vector<double*> blocks;  ///< the free ones: cameras in their order, then knots
};

AssembledProblem AssembleProblem(const CalibrationProblem& problem);

/// Solves it with the options, which get the groups' preparation.
void SolveAssembled(const AssembledProblem& assembled, ceres::Solver::Options options,
                    ceres::Solver::Summary* summary);

}  // namespace scenecalib
