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

/// Where each parameter block begins among the columns of a Jacobian, and which columns are not
/// solved for but in doubt.
struct Columns {
  std::map<const double*, Eigen::Index> solved;  ///< first column among the solved ones
  SparseMatrix select_solved;                    ///< all columns x solved ones
  SparseMatrix select_doubted;                   ///< all columns x doubted ones, times their sigma
};

Columns SplitColumns(const CalibrationProblem& p, const AssembledProblem& assembled) {
  std::map<const double*, Eigen::Vector3d> doubted;
  for (std::size_t c = 0; c < p.doubt_held_intrinsics.size(); ++c) {
    if (p.doubt_held_intrinsics[c]) {
      doubted[(*p.cameras)[c].intrinsics.data()] = p.priors[c].IntrinsicsStddev();
    }
  }
  using Entry = Eigen::Triplet<double>;
  std::vector<Entry> solved_entries;
  std::vector<Entry> doubted_entries;
  Columns columns;
  int column = 0;
  int num_solved = 0;
  int num_doubted = 0;
  for (double* block : assembled.blocks) {
    const int size = assembled.problem->ParameterBlockSize(block);
    const auto doubt = doubted.find(block);
    if (doubt == doubted.end()) columns.solved[block] = num_solved;
    for (int k = 0; k < size; ++k, ++column) {
      if (doubt == doubted.end()) {
        solved_entries.emplace_back(column, num_solved++, 1.0);
      } else {
        doubted_entries.emplace_back(column, num_doubted++, doubt->second[k]);
      }
    }
  }
  columns.select_solved.resize(column, num_solved);
  columns.select_solved.setFromTriplets(solved_entries.begin(), solved_entries.end());
  columns.select_doubted.resize(column, num_doubted);
  columns.select_doubted.setFromTriplets(doubted_entries.begin(), doubted_entries.end());
  return columns;
}

/// Largest of two covariances' standard deviations, axis by axis, after turning into other axes,
/// with what doubted parameters add to either.
Eigen::Vector3d LargerStddev(const Eigen::Matrix3d& formal, const Eigen::Matrix3d& sandwich,
                             const Eigen::Matrix3d& by_doubt,
                             const Eigen::Matrix3d& target_from_source) {
  const auto diagonal = [&target_from_source](const Eigen::Matrix3d& covariance) {
    return Eigen::Vector3d(
        (target_from_source * covariance * target_from_source.transpose()).diagonal());
  };
  const Eigen::Vector3d variance =
      diagonal(formal).cwiseMax(diagonal(sandwich)) + diagonal(by_doubt);
  return variance.cwiseMax(0.0).cwiseSqrt();
}

}  // namespace

Result<std::vector<CameraStddev>> CalibrationProblem::EstimateStddev(
    std::optional<double> block_s) const {
  std::vector<bool> held = hold_intrinsics;
  for (std::size_t c = 0; c < doubt_held_intrinsics.size() && c < held.size(); ++c) {
    held[c] = held[c] && !doubt_held_intrinsics[c];
  }
  const AssembledProblem assembled = AssembleProblem(*this, held);
  const Columns columns = SplitColumns(*this, assembled);
  SparseMatrix all_data;
  SparseMatrix all_prior;
  Eigen::VectorXd residuals;
  Eigen::VectorXd prior_residuals;
  if (!EvaluateBlocks(assembled, assembled.terms, &all_data, &residuals) ||
      !EvaluateBlocks(assembled, assembled.priors, &all_prior, &prior_residuals)) {
    return Status::NumericalFailure("residuals cannot be evaluated at the solution");
  }
  const SparseMatrix data = all_data * columns.select_solved;
  const SparseMatrix prior = all_prior * columns.select_solved;
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
  // What one sigma of each doubted parameter moves the solution by.
  const Eigen::MatrixXd doubt = factor.solve(
      Eigen::MatrixXd(data.transpose() * SparseMatrix(all_data * columns.select_doubted)));

  std::vector<CameraStddev> result(cameras->size());
  for (std::size_t c = 0; c < cameras->size(); ++c) {
    CameraParameters& camera = (*cameras)[c];
    const Eigen::Matrix3d camera_from_lidar = camera.LidarFromCamera().RotationMatrix().transpose();
    const auto stddev_of = [&](const double* block, int size, const Eigen::Matrix3d& turn) {
      Eigen::Matrix3d formal = Eigen::Matrix3d::Zero();
      Eigen::Matrix3d sandwich = Eigen::Matrix3d::Zero();
      Eigen::Matrix3d by_doubt = Eigen::Matrix3d::Zero();
      const auto found = columns.solved.find(block);
      if (found == columns.solved.end()) return Eigen::Vector3d(0.0, 0.0, 0.0);
      const Eigen::Index column = found->second;
      Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(data.cols(), size);
      unit.middleRows(column, size).setIdentity();
      const Eigen::MatrixXd inverse = factor.solve(unit);
      const Eigen::MatrixXd spread = influence.middleRows(column, size);
      const Eigen::MatrixXd prior_share = prior * inverse;
      const Eigen::MatrixXd doubt_share = doubt.middleRows(column, size);
      formal.topLeftCorner(size, size) = inverse.middleRows(column, size);
      if (block_s) {
        sandwich.topLeftCorner(size, size) =
            spread * spread.transpose() + prior_share.transpose() * prior_share;
      }
      by_doubt.topLeftCorner(size, size) = doubt_share * doubt_share.transpose();
      return LargerStddev(formal, sandwich, by_doubt, turn);
    };
    const Eigen::Matrix3d same = Eigen::Matrix3d::Identity();
    result[c].rotation_rad = stddev_of(camera.rotation_delta_rad.data(), 3, camera_from_lidar);
    result[c].translation_m = stddev_of(camera.translation_delta_m.data(), 3, camera_from_lidar);
    const Eigen::Vector3d intrinsics = c < doubt_held_intrinsics.size() && doubt_held_intrinsics[c]
                                           ? priors[c].IntrinsicsStddev()
                                           : stddev_of(camera.intrinsics.data(), 3, same);
    result[c].focal_scale = intrinsics[0];
    result[c].principal_point_px = intrinsics.tail<2>();
    result[c].time_offset_s = stddev_of(&camera.time_offset_delta_s, 1, same)[0];
  }
  return result;
}

}  // namespace scenecalib
