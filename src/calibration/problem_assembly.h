#pragma once

#include <ceres/problem.h>

#include <memory>
#include <vector>

#include "scenecalib/calibration/calibration_problem.h"
#include "term_group.h"

namespace scenecalib {

/// A Ceres problem over a CalibrationProblem's parameters, which must outlive it.
struct AssembledProblem {
  std::vector<std::unique_ptr<TermGroup>> groups;  ///< of CalibrationProblem::terms
  std::unique_ptr<ceres::Problem> problem;
  std::vector<ceres::ResidualBlockId> priors;
  std::vector<double*> blocks;  ///< the free ones: cameras in their order, then knots
};

AssembledProblem AssembleProblem(const CalibrationProblem& problem);

}  // namespace scenecalib
