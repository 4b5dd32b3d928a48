#include <ceres/crs_matrix.h>
#include <ceres/problem.h>

#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <cmath>
#include <map>
#include <optional>

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

Result<std::vector<CameraStddev>> CalibrationProblem::EstimateStddev(
    std::optional<double> block_s) const {
  const AssembledProblem assembled = AssembleProblem(*this);
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
  // Sandwich H^-1 (sum_b g_b g_b^T + P^T P) H^-1: the spread of the scores over blocks of time.
  const Eigen::MatrixXd influence =
      block_s ? Eigen::MatrixXd(factor.solve(ScoresByBlock(terms, data, residuals, *block_s)))
              : Eigen::MatrixXd::Zero(data.cols(), 0);

  std::vector<CameraStddev> result(cameras->size());
  Eigen::Index column = 0;
  for (std::size_t c = 0; c < cameras->size(); ++c) {
    CameraParameters& camera = (*cameras)[c];
    const Eigen::Matrix3d camera_from_lidar = camera.LidarFromCamera().RotationMatrix().transpose();
    const auto next = [&](const double* block, int size, const Eigen::Matrix3d& turn) {
      Eigen::Matrix3d formal = Eigen::Matrix3d::Zero();
      Eigen::Matrix3d sandwich = Eigen::Matrix3d::Zero();
      if (!assembled.IsFree(block)) return Eigen::Vector3d(0.0, 0.0, 0.0);
      Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(data.cols(), size);
      unit.middleRows(column, size).setIdentity();
      const Eigen::MatrixXd inverse = factor.solve(unit);
      const Eigen::MatrixXd spread = influence.middleRows(column, size);
      const Eigen::MatrixXd prior_share = prior * inverse;
      formal.topLeftCorner(size, size) = inverse.middleRows(column, size);
      if (block_s) {
        sandwich.topLeftCorner(size, size) =
            spread * spread.transpose() + prior_share.transpose() * prior_share;
      }
      column += size;
      return LargerStddev(formal, sandwich, turn);
    };
    const Eigen::Matrix3d same = Eigen::Matrix3d::Identity();
    result[c].rotation_rad = next(camera.rotation_delta_rad.data(), 3, camera_from_lidar);
    result[c].translation_m = next(camera.translation_delta_m.data(), 3, camera_from_lidar);
    const Eigen::Vector3d intrinsics = next(camera.intrinsics.data(), 3, same);
    result[c].focal_scale = intrinsics[0];
    result[c].principal_point_px = intrinsics.tail<2>();
    result[c].time_offset_s = next(&camera.time_offset_delta_s, 1, same)[0];
  }
  return result;
}

}  // namespace scenecalib
