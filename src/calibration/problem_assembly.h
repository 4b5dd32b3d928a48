#pragma once

#include <ceres/problem.h>

#include <memory>
#include <vector>

#include "scenecalib/calibration/calibration_problem.h"

namespace scenecalib {

/// A Ceres problem over a CalibrationProblem's parameters, which must outlive it.
struct AssembledProblem {
  std::unique_ptr<ceres::Problem> problem;
  std::vector<ceres::ResidualBlockId> terms;  ///< in the order of CalibrationProblem::terms
  std::vector<ceres::ResidualBlockId> priors;
  std::vector<double*> blocks;  ///< the free ones: cameras in their order, then knots
};

AssembledProblem AssembleProblem(const CalibrationProblem& problem);

}  // namespace scenecalib
