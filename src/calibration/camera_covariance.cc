#include <ceres/crs_matrix.h>
#include <ceres/problem.h>

#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "misfits.h"
#include "problem_assembly.h"
#include "scenecalib/calibration/calibration_problem.h"
#include "term_group.h"

namespace scenecalib {
namespace {

/// Errors that all seconds share (of the surfaces, of the registration of patches) are seen neither
/// by the formal covariance nor by the spread over seconds. On simulated drives the squared errors
/// are two to this many times what both say (docs/accuracy.md).
constexpr double kCommonErrors = 3.0;

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

/// What one piece of surface says: J^T W r of the terms on it, at the columns that they depend on.
struct SurfaceScore {
  std::vector<Eigen::Index> columns;
  Eigen::VectorXd gradient;
};

std::vector<SurfaceScore> ScoresOfSurfaces(
    const CalibrationProblem& p, const std::map<const double*, Eigen::Index>& first_columns) {
  std::vector<SurfaceScore> scores;
  for (const auto& group : GroupTermsBySurface(p)) {
    GroupEquations equations;
    if (!group->Evaluate(group->blocks().data(), true, &equations)) continue;
    SurfaceScore score;
    for (std::size_t b = 0; b < group->blocks().size(); ++b) {
      for (int k = 0; k < group->block_sizes()[b]; ++k) {
        score.columns.push_back(first_columns.at(group->blocks()[b]) + k);
      }
    }
    score.gradient = std::move(equations.gradient);
    scores.push_back(std::move(score));
  }
  return scores;
}

/// Few clusters say too little of their own spread.
double FewClusters(Eigen::Index num_clusters) {
  const auto n = static_cast<double>(num_clusters);
  return num_clusters > 1 ? n / (n - 1.0) : 1.0;
}

/// Spread of a camera's parameters over the pieces of surface; `inverse` has the parameters'
/// columns of H^-1.
CameraMatrix SpreadOverSurfaces(const std::vector<SurfaceScore>& scores,
                                const Eigen::MatrixXd& inverse) {
  CameraMatrix spread = CameraMatrix::Zero();
  for (const SurfaceScore& score : scores) {
    Eigen::Matrix<double, kNumCameraParameters, 1> influence;
    influence.setZero();
    for (std::size_t i = 0; i < score.columns.size(); ++i) {
      influence +=
          score.gradient[static_cast<Eigen::Index>(i)] * inverse.row(score.columns[i]).transpose();
    }
    spread += influence * influence.transpose();
  }
  return FewClusters(static_cast<Eigen::Index>(scores.size())) * spread;
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

/// A constant error of the lidar's poses is one of every camera's, in any axes.
CameraMatrix OfLidarFrame(const CorrectionPrior& prior) {
  CameraMatrix covariance = CameraMatrix::Zero();
  for (int i = 0; i < 3; ++i) {
    covariance(i, i) = prior.frame_translation_m * prior.frame_translation_m;
    covariance(3 + i, 3 + i) = prior.frame_rotation_rad * prior.frame_rotation_rad;
  }
  return covariance;
}

/// Standard deviations by the largest of the covariances, parameter by parameter, and the
/// correlation of their sum.
CameraStddev StddevOf(std::initializer_list<CameraMatrix> covariances) {
  using Vector = Eigen::Matrix<double, kNumCameraParameters, 1>;
  CameraMatrix sum = CameraMatrix::Zero();
  Vector variance = Vector::Zero();
  for (const CameraMatrix& covariance : covariances) {
    sum += covariance;
    variance = variance.cwiseMax(covariance.diagonal());
  }
  const Vector sigma = variance.cwiseSqrt();
  CameraStddev stddev;
  stddev.translation_m = sigma.head<3>();
  stddev.rotation_rad = sigma.segment<3>(3);
  stddev.focal_scale = sigma[6];
  stddev.principal_point_px = sigma.segment<2>(7);
  stddev.time_offset_s = sigma[9];
  const Vector scale = sum.diagonal().unaryExpr(
      [](double variance) { return variance > 0.0 ? 1.0 / std::sqrt(variance) : 0.0; });
  stddev.correlation = scale.asDiagonal() * sum * scale.asDiagonal();
  stddev.correlation.diagonal().setOnes();
  return stddev;
}

}  // namespace

Result<CalibrationUncertainty> CalibrationProblem::EstimateUncertainty() const {
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
  // Sandwiches H^-1 (sum_b g_b g_b^T + Q^T Q) H^-1: the spread of the scores over seconds or over
  // pieces of surface, and of the priors.
  const Eigen::MatrixXd influence = factor.solve(data->scores);
  const std::vector<SurfaceScore> surface_scores = ScoresOfSurfaces(*this, first_columns);
  const SparseMatrix prior_spread = SpreadOfPriors(*this, prior, first_columns);

  const SolvedEquations solved{*this, assembled, first_columns, factor, kCommonErrors};
  MisfitEstimate misfits = EstimateMisfits(solved);
  const Eigen::MatrixXd misfit_errors = misfits.Errors(lenses_follow);

  CalibrationUncertainty result;
  result.stddev.resize(cameras->size());
  for (std::size_t c = 0; c < cameras->size(); ++c) {
    const CameraParameters& camera = (*cameras)[c];
    // Rows of all parameters that turn this camera's into its own axes; zero where one is held.
    Eigen::MatrixXd pick = Eigen::MatrixXd::Zero(prior.cols(), kNumCameraParameters);
    const auto place = [&](const double* block, int row, const Eigen::MatrixXd& target_from_block) {
      const auto found = first_columns.find(block);
      if (found == first_columns.end()) return;
      pick.block(found->second, row, target_from_block.cols(), target_from_block.rows()) =
          target_from_block.transpose();
    };
    const Eigen::Matrix3d camera_from_lidar = camera.LidarFromCamera().RotationMatrix().transpose();
    place(camera.translation_delta_m.data(), 0, camera_from_lidar);
    place(camera.rotation_delta_rad.data(), 3, camera_from_lidar);
    place(camera.intrinsics.data(), 6, Eigen::Matrix3d::Identity());
    place(&camera.time_offset_delta_s, 9, Eigen::MatrixXd::Identity(1, 1));
    const Eigen::MatrixXd inverse = factor.solve(pick);
    const Eigen::MatrixXd spread = pick.transpose() * influence;
    const Eigen::MatrixXd prior_share = prior_spread * inverse;
    const CameraMatrix of_prior = prior_share.transpose() * prior_share;
    const Eigen::MatrixXd by_misfits = pick.transpose() * misfits.response;
    const CameraMatrix of_held = by_misfits * misfit_errors * by_misfits.transpose();
    const CameraMatrix of_outside = of_held + OfLidarFrame(correction_prior);
    const CameraMatrix of_others = of_prior + of_outside;
    const CameraMatrix formal = kCommonErrors * pick.transpose() * inverse + of_outside;
    const CameraMatrix over_seconds =
        kCommonErrors * FewClusters(spread.cols()) * spread * spread.transpose() + of_others;
    const CameraMatrix over_surfaces =
        kCommonErrors * SpreadOverSurfaces(surface_scores, inverse) + of_others;
    result.stddev[c] = StddevOf({formal, over_seconds, over_surfaces});
  }
  result.lenses = std::move(misfits.lenses);
  result.clocks = std::move(misfits.clocks);
  return result;
}

}  // namespace scenecalib
