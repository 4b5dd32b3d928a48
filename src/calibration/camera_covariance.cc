#include <ceres/crs_matrix.h>
#include <ceres/problem.h>

#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "problem_assembly.h"
#include "scenecalib/calibration/calibration_problem.h"

namespace scenecalib {
namespace {

/// Errors that all seconds share (of the surfaces, of the registration of patches) are seen neither
/// by the formal covariance nor by the spread over seconds. On simulated drives the squared errors
/// are this many times what both say (docs/accuracy.md).
constexpr double kCommonErrors = 4.0;

using SparseMatrix = Eigen::SparseMatrix<double, Eigen::RowMajor>;
using ColumnMatrix = Eigen::SparseMatrix<double>;

bool EvaluatePriors(const AssembledProblem& assembled, SparseMatrix* jacobian) {
  ceres::Problem::EvaluateOptions options;
  options.parameter_blocks = assembled.blocks;
  options.residual_blocks = assembled.priors;
  options.num_threads = 1;
  ceres::CRSMatrix crs;
  if (!assembled.problem->Evaluate(options, nullptr, nullptr, nullptr, &crs)) return false;
  *jacobian = Eigen::Map<const SparseMatrix>(crs.num_rows, crs.num_cols,
                                             static_cast<Eigen::Index>(crs.values.size()),
                                             crs.rows.data(), crs.cols.data(), crs.values.data());
  return true;
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

/// What the data says of all parameters: J^T W J, and J^T W r by second of the targets, a column
/// each.
struct DataEquations {
  ColumnMatrix information;
  Eigen::MatrixXd scores;
};

std::optional<DataEquations> SumOfGroups(const AssembledProblem& assembled,
                                         const std::map<const double*, Eigen::Index>& first_columns,
                                         Eigen::Index num_columns) {
  std::vector<Eigen::Triplet<double>> entries;
  std::map<Timestamp, Eigen::VectorXd> scores;
  for (const auto& group : assembled.groups) {
    const std::vector<double*>& blocks = group->blocks();
    GroupEquations equations;
    if (!group->Evaluate(blocks.data(), true, &equations)) return std::nullopt;
    std::vector<Eigen::Index> columns;
    for (std::size_t b = 0; b < blocks.size(); ++b) {
      for (int k = 0; k < group->block_sizes()[b]; ++k) {
        columns.push_back(first_columns.at(blocks[b]) + k);
      }
    }
    Eigen::VectorXd& score =
        scores.try_emplace(group->target_second(), Eigen::VectorXd::Zero(num_columns))
            .first->second;
    for (std::size_t i = 0; i < columns.size(); ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      score[columns[i]] += equations.gradient[row];
      for (std::size_t j = 0; j < columns.size(); ++j) {
        const auto column = static_cast<Eigen::Index>(j);
        entries.emplace_back(columns[i], columns[j],
                             equations.information(std::max(row, column), std::min(row, column)));
      }
    }
  }
  DataEquations sum;
  sum.information.resize(num_columns, num_columns);
  sum.information.setFromTriplets(entries.begin(), entries.end());
  sum.scores.resize(num_columns, static_cast<Eigen::Index>(scores.size()));
  Eigen::Index column = 0;
  for (const auto& entry : scores) sum.scores.col(column++) = entry.second;
  return sum;
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

Result<std::vector<CameraStddev>> CalibrationProblem::EstimateStddev() const {
  const AssembledProblem assembled = AssembleProblem(*this);
  const std::map<const double*, Eigen::Index> first_columns = FirstColumns(assembled);
  SparseMatrix prior;
  if (!EvaluatePriors(assembled, &prior)) {
    return Status::NumericalFailure("priors cannot be evaluated at the solution");
  }
  const std::optional<DataEquations> data = SumOfGroups(assembled, first_columns, prior.cols());
  if (!data) return Status::NumericalFailure("residuals cannot be evaluated at the solution");
  const ColumnMatrix information = data->information + ColumnMatrix(prior.transpose() * prior);
  const Eigen::SimplicialLDLT<ColumnMatrix> factor(information);
  if (factor.info() != Eigen::Success) {
    return Status::NumericalFailure("the normal equations are singular");
  }
  // Sandwich H^-1 (sum_b g_b g_b^T + Q^T Q) H^-1: the spread of the scores over seconds, and of the
  // priors.
  const Eigen::MatrixXd influence = factor.solve(data->scores);
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
      Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(prior.cols(), size);
      unit.middleRows(column, size).setIdentity();
      const Eigen::MatrixXd inverse = factor.solve(unit);
      const Eigen::MatrixXd spread = influence.middleRows(column, size);
      const Eigen::MatrixXd prior_share = prior_spread * inverse;
      formal.topLeftCorner(size, size) = kCommonErrors * inverse.middleRows(column, size);
      sandwich.topLeftCorner(size, size) =
          kCommonErrors * spread * spread.transpose() + prior_share.transpose() * prior_share;
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
