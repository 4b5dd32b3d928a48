#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <map>
#include <vector>

#include "problem_assembly.h"
#include "scenecalib/calibration/calibration_problem.h"
#include "scenecalib/calibration/radial_misfit.h"

namespace scenecalib {

/// What a solution says of its lenses' radial coefficients, were all else to follow them.
struct LensEstimate {
  std::vector<RadialMisfit> lenses;  ///< parallel to the cameras
  Eigen::MatrixXd covariance;        ///< of the changes
  /// How all parameters of the problem follow a change; a column per lens.
  Eigen::MatrixXd response;
};

/// One Newton step of the coefficients on the cost of which all other parameters are minimised, at
/// a solution of the problem (docs/math.md, section 6). `factor` is of its normal equations,
/// `first_columns` tells where the blocks lie in them. `common_errors` multiplies the covariance.
LensEstimate EstimateLenses(const CalibrationProblem& problem, const AssembledProblem& assembled,
                            const std::map<const double*, Eigen::Index>& first_columns,
                            const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>& factor,
                            double common_errors);

}  // namespace scenecalib
