#include <ceres/crs_matrix.h>
#include <ceres/problem.h>

#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <cmath>
#include <map>

#include "problem_assembly.h"
#include "scenecalib/calibration/calibration_problem.h"

namespace scenecalib {
namespace {

using SparseMatrix = Eigen::SparseMatrix<double, Eigen::RowMajor>;
using ColumnMatrix = Eigen::SparseMatrix<double>;

/// Robustified Jacobian and residuals of the given residual blocks.
bool EvaluateBlocks(const AssembledProblem& assembled,
                    const std::vector<ceres::ResidualBlockId>& ids, SparseMatrix* jacobian,
                    Eigen::VectorXd* residuals) {
  if (ids.empty()) return false;
  ceres::Problem::EvaluateOptions options;
  options.parameter_blocks = assembled.blocks;
  options.residual_blocks = ids;
  options.num_threads = 1;
  ceres::CRSMatrix crs;
  std::vector<double> values;
  if (!assembled.problem->Evaluate(options, nullptr, &values, nullptr, &crs)) return false;
  *jacobian = Eigen::Map<const SparseMatrix>(crs.num_rows, crs.num_cols,
                                             static_cast<Eigen::Index>(crs.values.size()),
                                             crs.rows.data(), crs.cols.data(), crs.values.data());
  *residuals =
      Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
  return true;
}

/// Gradient of the data's cost, summed by block of time: one column per block.
Eigen::MatrixXd ScoresByBlock(const std::vector<TransferTerm>& terms, const SparseMatrix& jacobian,
                              const Eigen::VectorXd& residuals, double block_s) {
  const auto block_ns = static_cast<Timestamp>(block_s * 1e9);
  std::map<Timestamp, Eigen::VectorXd> scores;
  for (std::size_t i = 0; i < terms.size(); ++i) {
    const auto entry = scores.try_emplace(terms[i].target_stamp_ns / block_ns,
                                          Eigen::VectorXd::Zero(jacobian.cols()));
    Eigen::VectorXd& score = entry.first->second;
    for (int row = static_cast<int>(2 * i); row < static_cast<int>(2 * i + 2); ++row) {
      for (SparseMatrix::InnerIterator it(jacobian, row); it; ++it) {
        score[it.col()] += it.value() * residuals[row];
      }
    }
  }
  Eigen::MatrixXd columns(jacobian.cols(), static_cast<Eigen::Index>(scores.size()));
  Eigen::Index column = 0;
  for (const auto& entry : scores) columns.col(column++) = entry.second;
  return columns;
}

/// First column of every parameter block of a Jacobian.
std::map<const double*, Eigen::Index> FirstColumns(const AssembledProblem& assembled) {
  std::map<const double*, Eigen::Index> first;
  Eigen::Index column = 0;
  for (const double* block : assembled.blocks) {
    first[block] = column;
    column += assembled.problem->ParameterBlockSize(block);
  }
  return first;
}

/// The priors' Jacobian as the errors of the prior spread: those of the intrinsics are
/// `intrinsics_weight` times as large as the solve took them to be.
SparseMatrix SpreadOfPriors(const CalibrationProblem& p, SparseMatrix prior,
                            const std::map<const double*, Eigen::Index>& first_columns) {
  std::vector<bool> is_intrinsic(prior.cols(), false);
  for (const CameraParameters& camera : *p.cameras) {
    const auto found = first_columns.find(camera.intrinsics.data());
    if (found == first_columns.end()) continue;
    for (int k = 0; k < 3; ++k) is_intrinsic[found->second + k] = true;
  }
  for (Eigen::Index row = 0; row < prior.rows(); ++row) {
    for (SparseMatrix::InnerIterator it(prior, row); it; ++it) {
      if (is_intrinsic[it.col()]) it.valueRef() *= p.intrinsics_prior_weight;
    }
  }
  return prior;
}

/// Largest of two covariances' standard deviations, axis by axis, after turning into other axes.
Eigen::Vector3d LargerStddev(const Eigen::Matrix3d& formal, const Eigen::Matrix3d& sandwich,
                             const Eigen::Matrix3d& target_from_source) {
  const auto diagonal = [&target_from_source](const Eigen::Matrix3d& covariance) {
    return Eigen::Vector3d(
        (target_from_source * covariance * target_from_source.transpose()).diagonal());
  };
  return diagonal(formal).cwiseMax(diagonal(sandwich)).cwiseMax(0.0).cwiseSqrt();
}

}  // namespace

Result<std::vector<CameraStddev>> CalibrationProblem::EstimateStddev(double block_s) const {
  const AssembledProblem assembled = AssembleProblem(*this);
  const std::map<const double*, Eigen::Index> first_columns = FirstColumns(assembled);
  SparseMatrix data;
  SparseMatrix prior;
  Eigen::VectorXd residuals;
  Eigen::VectorXd prior_residuals;
  if (!EvaluateBlocks(assembled, assembled.terms, &data, &residuals) ||
      !EvaluateBlocks(assembled, assembled.priors, &prior, &prior_residuals)) {
    return Status::NumericalFailure("residuals cannot be evaluated at the solution");
  }
  const ColumnMatrix information =
      ColumnMatrix(data.transpose() * data) + ColumnMatrix(prior.transpose() * prior);
  const Eigen::SimplicialLDLT<ColumnMatrix> factor(information);
  if (factor.info() != Eigen::Success) {
    return Status::NumericalFailure("the normal equations are singular");
  }
  // Sandwich H^-1 (sum_b g_b g_b^T + Q^T Q) H^-1: the spread of the scores over blocks of time, and
  // of the priors.
  const Eigen::MatrixXd influence = factor.solve(ScoresByBlock(terms, data, residuals, block_s));
  const SparseMatrix prior_spread = SpreadOfPriors(*this, prior, first_columns);

  std::vector<CameraStddev> result(cameras->size());
  for (std::size_t c = 0; c < cameras->size(); ++c) {
    CameraParameters& camera = (*cameras)[c];
    const Eigen::Matrix3d camera_from_lidar = camera.LidarFromCamera().RotationMatrix().transpose();
    const auto stddev_of = [&](const double* block, int size, const Eigen::Matrix3d& turn) {
      Eigen::Matrix3d formal = Eigen::Matrix3d::Zero();
      Eigen::Matrix3d sandwich = Eigen::Matrix3d::Zero();
      const auto found = first_columns.find(block);
      if (found == first_columns.end()) return Eigen::Vector3d(0.0, 0.0, 0.0);
      const Eigen::Index column = found->second;
      Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(data.cols(), size);
      unit.middleRows(column, size).setIdentity();
      const Eigen::MatrixXd inverse = factor.solve(unit);
      const Eigen::MatrixXd spread = influence.middleRows(column, size);
      const Eigen::MatrixXd prior_share = prior_spread * inverse;
      formal.topLeftCorner(size, size) = inverse.middleRows(column, size);
      sandwich.topLeftCorner(size, size) =
          spread * spread.transpose() + prior_share.transpose() * prior_share;
      return LargerStddev(formal, sandwich, turn);
    };
    const Eigen::Matrix3d same = Eigen::Matrix3d::Identity();
    result[c].rotation_rad = stddev_of(camera.rotation_delta_rad.data(), 3, camera_from_lidar);
    result[c].translation_m = stddev_of(camera.translation_delta_m.data(), 3, camera_from_lidar);
    const Eigen::Vector3d intrinsics = stddev_of(camera.intrinsics.data(), 3, same);
    result[c].focal_scale = intrinsics[0];
    result[c].principal_point_px = intrinsics.tail<2>();
    result[c].time_offset_s = stddev_of(&camera.time_offset_delta_s, 1, same)[0];
  }
  return result;
}

}  // namespace scenecalib
