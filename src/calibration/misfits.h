#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <map>
#include <vector>

#include "problem_assembly.h"
#include "scenecalib/calibration/calibration_problem.h"
#include "scenecalib/calibration/clock_misfit.h"
#include "scenecalib/calibration/radial_misfit.h"

namespace scenecalib {

/// A solution's normal equations, to ask it about what was not solved for.
struct SolvedEquations {
  const CalibrationProblem& problem;
  const AssembledProblem& assembled;
  const std::map<const double*, Eigen::Index>& first_columns;  ///< where the blocks lie
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>& factor;
  double common_errors = 1.0;  ///< multiplies covariances
};

/// What a solution says of what it holds: three parameters of every camera that no solve moves by
/// itself, its lens' radial coefficient, the time between its rows and (unless the problem solves
/// for it) its time offset, were all else to follow them. Parallel to the cameras.
struct MisfitEstimate {
  std::vector<RadialMisfit> lenses;
  std::vector<ClockMisfit> clocks;
  /// Of the three, camera by camera.
  Eigen::MatrixXd covariance;
  /// How all parameters of the problem follow a change; a column each.
  Eigen::MatrixXd response;

  /// Their errors, squared: lenses that follow the data are as uncertain as it is, everything else
  /// is off by what the data says beyond chance.
  Eigen::MatrixXd Errors(bool lenses_follow) const;
};

/// One Newton step of these parameters, all together, on the cost of which all others are
/// minimised, at a solution of the problem (docs/math.md, section 6).
MisfitEstimate EstimateMisfits(const SolvedEquations& solved);

}  // namespace scenecalib
