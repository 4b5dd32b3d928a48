#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <map>
#include <vector>

#include "problem_assembly.h"
#include "scenecalib/calibration/calibration_problem.h"
#include "scenecalib/calibration/radial_misfit.h"
#include "scenecalib/calibration/shutter_misfit.h"

namespace scenecalib {

/// A solution's normal equations, to ask it about what was not solved for.
struct SolvedEquations {
  const CalibrationProblem& problem;
  const AssembledProblem& assembled;
  const std::map<const double*, Eigen::Index>& first_columns;  ///< where the blocks lie
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>& factor;
  double common_errors = 1.0;  ///< multiplies covariances
};

/// What a solution says of its lenses' radial coefficients, were all else to follow them.
struct LensEstimate {
  std::vector<RadialMisfit> lenses;  ///< parallel to the cameras
  Eigen::MatrixXd covariance;        ///< of the changes
  /// How all parameters of the problem follow a change; a column per lens.
  Eigen::MatrixXd response;
};

/// One Newton step of the coefficients on the cost of which all other parameters are minimised, at
/// a solution of the problem (docs/math.md, section 6).
LensEstimate EstimateLenses(const SolvedEquations& solved);

/// The same of the time between the cameras' rows, about the middle one: whether their images are
/// exposed row by row other than the rig file says. Parallel to the cameras.
std::vector<ShutterMisfit> EstimateShutters(const SolvedEquations& solved);

}  // namespace scenecalib
