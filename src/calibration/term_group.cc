#include "term_group.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

namespace scenecalib {
namespace {

constexpr Timestamp kSecond_ns = 1000000000;
/// Terms of a group that one thread sums up: a fixed share, so that the sum has a fixed order.
constexpr std::size_t kMinTermsPerSlice = 1000;
constexpr std::size_t kMaxSlices = 8;
/// Pivots of the information matrix below this share of the largest one belong to directions that
/// the group says nothing about.
constexpr double kMinPivotShare = 1e-14;

int SourceSecond(const TransferTerm& term, const CalibrationProblem& problem) {
  if (!problem.free.correction) return 0;
  return static_cast<int>(term.source_place.index * problem.correction->knot_spacing_s());
}

}  // namespace

/// The values that a group's terms are evaluated at.
struct TermGroup::State {
  std::vector<CameraParameters> cameras;
  std::vector<const double*> knots;

  Vector6d CorrectionAt(const TrajectoryCorrection::Place& place) const {
    if (knots.empty()) return Vector6d::Zero();
    return (1.0 - place.fraction) * Eigen::Map<const Vector6d>(knots[place.index]) +
           place.fraction * Eigen::Map<const Vector6d>(knots[place.index + 1]);
  }
};

/// Jacobian of one whitened residual, by the blocks that it depends on.
struct TermGroup::TermJacobian {
  static constexpr int kMaxBlocks = 12;
  static constexpr int kMaxColumns = 44;  ///< two cameras of 10 and four knots of 6

  Eigen::Matrix<double, 2, kMaxColumns> values;
  int first_column[kMaxBlocks];  ///< among the group's columns
  int place[kMaxBlocks];         ///< among the values'
  int size[kMaxBlocks];
  int num_blocks = 0;
  int num_columns = 0;

  /// A block that two parts of the term depend on is the sum of both.
  template <typename Derived>
  void Add(int column, const Eigen::MatrixBase<Derived>& jacobian) {
    if (column < 0) return;
    const auto columns = static_cast<int>(jacobian.cols());
    for (int i = 0; i < num_blocks; ++i) {
      if (first_column[i] != column) continue;
      values.middleCols(place[i], columns) += jacobian;
      return;
    }
    first_column[num_blocks] = column;
    place[num_blocks] = num_columns;
    size[num_blocks] = columns;
    values.middleCols(num_columns, columns) = jacobian;
    num_columns += columns;
    ++num_blocks;
  }

  void AddTo(const Eigen::Vector2d& residual, GroupEquations* equations) const {
    for (int i = 0; i < num_blocks; ++i) {
      const auto left = values.middleCols(place[i], size[i]);
      equations->gradient.segment(first_column[i], size[i]) += left.transpose() * residual;
      for (int j = 0; j < num_blocks; ++j) {
        if (first_column[j] > first_column[i]) continue;
        equations->information.block(first_column[i], first_column[j], size[i], size[j])
            .noalias() += left.transpose().lazyProduct(values.middleCols(place[j], size[j]));
      }
    }
  }
};

TermGroup::TermGroup(const CalibrationProblem& problem, std::vector<int> terms)
    : problem_(problem),
      terms_(std::move(terms)),
      camera_columns_(problem.cameras->size()),
      knot_columns_(problem.correction->knots().size(), -1) {
  // Blocks in a fixed order: cameras, then knots.
  std::vector<bool> has_camera(problem.cameras->size(), false);
  std::vector<bool> has_knot(knot_columns_.size(), false);
  for (const int i : terms_) {
    const TransferTerm& term = problem.terms[i];
    for (const int camera : {term.source_camera, term.target_camera}) has_camera[camera] = true;
    if (!problem.free.correction) continue;
    for (const auto& place : {term.source_place, term.target_place}) {
      has_knot[place.index] = true;
      has_knot[place.index + 1] = true;
    }
  }
  for (std::size_t c = 0; c < has_camera.size(); ++c) {
    if (has_camera[c]) AddCamera(static_cast<int>(c));
  }
  for (std::size_t k = 0; k < has_knot.size(); ++k) {
    if (has_knot[k]) knot_columns_[k] = AddBlock(problem.correction->knots()[k].data(), 6);
  }
  if (!terms_.empty()) target_second_ = problem.terms[terms_[0]].target_stamp_ns / kSecond_ns;
}

int TermGroup::AddBlock(double* values, int size) {
  blocks_.push_back(values);
  block_sizes_.push_back(size);
  num_columns_ += size;
  return num_columns_ - size;
}

void TermGroup::AddCamera(int camera) {
  CameraParameters& parameters = (*problem_.cameras)[camera];
  CameraColumns& columns = camera_columns_[camera];
  const FreeParameters& free = problem_.free;
  if (free.rotation) columns.rotation = AddBlock(parameters.rotation_delta_rad.data(), 3);
  if (free.translation) columns.translation = AddBlock(parameters.translation_delta_m.data(), 3);
  if (free.intrinsics) columns.intrinsics = AddBlock(parameters.intrinsics.data(), 3);
  if (free.time_offset) columns.time_offset = AddBlock(&parameters.time_offset_delta_s, 1);
}

TermGroup::State TermGroup::StateAt(double const* const* values) const {
  State state;
  state.cameras = *problem_.cameras;
  for (const Vector6d& knot : problem_.correction->knots()) state.knots.push_back(knot.data());
  std::map<int, const double*> value_of_column;
  int column = 0;
  for (std::size_t i = 0; i < blocks_.size(); ++i) {
    value_of_column[column] = values[i];
    column += block_sizes_[i];
  }
  const auto read = [&value_of_column](int first, int size, double* out) {
    if (first >= 0) std::copy_n(value_of_column.at(first), size, out);
  };
  for (std::size_t c = 0; c < state.cameras.size(); ++c) {
    read(camera_columns_[c].rotation, 3, state.cameras[c].rotation_delta_rad.data());
    read(camera_columns_[c].translation, 3, state.cameras[c].translation_delta_m.data());
    read(camera_columns_[c].intrinsics, 3, state.cameras[c].intrinsics.data());
    read(camera_columns_[c].time_offset, 1, &state.cameras[c].time_offset_delta_s);
  }
  for (std::size_t k = 0; k < state.knots.size(); ++k) {
    if (knot_columns_[k] >= 0) state.knots[k] = value_of_column.at(knot_columns_[k]);
  }
  return state;
}

void TermGroup::AddCameraColumns(const TransferTerm& term, const TransferViewJacobians& by_view,
                                 const TransferView& view, int camera,
                                 TermJacobian* jacobian) const {
  const Eigen::Matrix2d weight = term.whitening / problem_.residual_sigma;
  const CameraColumns& columns = camera_columns_[camera];
  jacobian->Add(columns.rotation, weight * by_view.by_rotation);
  jacobian->Add(columns.translation, weight * by_view.by_translation);
  jacobian->Add(columns.intrinsics, weight * by_view.by_intrinsics);
  if (columns.time_offset >= 0) {
    jacobian->Add(columns.time_offset, weight * (by_view.by_correction * view.twist_in_lidar));
  }
}

bool TermGroup::EvaluateSlice(const State& state, std::size_t first, std::size_t last,
                              bool with_derivatives, GroupEquations* equations) const {
  const double loss_square = problem_.loss_scale * problem_.loss_scale;
  for (std::size_t i = first; i < last; ++i) {
    const TransferTerm& term = problem_.terms[terms_[i]];
    Eigen::Vector2d residual_px;
    TransferJacobians all;
    if (!EvaluateTransfer(term.source, state.cameras[term.source_camera],
                          state.CorrectionAt(term.source_place), term.target,
                          state.cameras[term.target_camera], state.CorrectionAt(term.target_place),
                          term.plane_point_in_map_m, term.plane_normal_in_map, &residual_px,
                          with_derivatives ? &all : nullptr)) {
      return false;
    }
    const Eigen::Matrix2d weight = term.whitening / problem_.residual_sigma;
    const Eigen::Vector2d residual = weight * residual_px;
    const double square = residual.squaredNorm() / loss_square;
    equations->cost += loss_square * std::log1p(square);  // Cauchy
    if (!with_derivatives) continue;
    TermJacobian jacobian;
    AddCameraColumns(term, all.source, term.source, term.source_camera, &jacobian);
    AddCameraColumns(term, all.target, term.target, term.target_camera, &jacobian);
    if (problem_.free.correction) {
      const auto add_knots = [&](const TrajectoryCorrection::Place& place,
                                 const Eigen::Matrix<double, 2, 6>& by_correction) {
        const Eigen::Matrix<double, 2, 6> weighted = weight * by_correction;
        jacobian.Add(knot_columns_[place.index], (1.0 - place.fraction) * weighted);
        jacobian.Add(knot_columns_[place.index + 1], place.fraction * weighted);
      };
      add_knots(term.source_place, all.source.by_correction);
      add_knots(term.target_place, all.target.by_correction);
    }
    const double root_weight = std::sqrt(1.0 / (1.0 + square));
    jacobian.values.leftCols(jacobian.num_columns) *= root_weight;
    jacobian.AddTo(root_weight * residual, equations);
  }
  return true;
}

bool TermGroup::Evaluate(double const* const* values, bool with_derivatives,
                         GroupEquations* equations) const {
  const State state = StateAt(values);
  const std::size_t num_slices =
      std::clamp<std::size_t>(terms_.size() / kMinTermsPerSlice, 1, kMaxSlices);
  std::vector<GroupEquations> slices(num_slices);
  std::vector<char> is_valid(num_slices, 0);
  tbb::parallel_for(std::size_t{0}, num_slices, [&](std::size_t s) {
    if (with_derivatives) {
      slices[s].information.setZero(num_columns_, num_columns_);
      slices[s].gradient.setZero(num_columns_);
    }
    is_valid[s] = EvaluateSlice(state, terms_.size() * s / num_slices,
                                terms_.size() * (s + 1) / num_slices, with_derivatives, &slices[s])
                      ? 1
                      : 0;
  });
  if (std::any_of(is_valid.begin(), is_valid.end(), [](char valid) { return valid == 0; })) {
    return false;
  }
  *equations = std::move(slices[0]);
  for (std::size_t s = 1; s < num_slices; ++s) {
    equations->cost += slices[s].cost;
    if (!with_derivatives) continue;
    equations->information += slices[s].information;
    equations->gradient += slices[s].gradient;
  }
  return true;
}

std::vector<std::unique_ptr<TermGroup>> GroupTerms(const CalibrationProblem& problem) {
  std::map<std::pair<Timestamp, int>, std::vector<int>> by_seconds;
  for (std::size_t i = 0; i < problem.terms.size(); ++i) {
    const TransferTerm& term = problem.terms[i];
    by_seconds[{term.target_stamp_ns / kSecond_ns, SourceSecond(term, problem)}].push_back(
        static_cast<int>(i));
  }
  std::vector<std::unique_ptr<TermGroup>> groups;
  groups.reserve(by_seconds.size());
  for (auto& entry : by_seconds) {
    groups.push_back(std::make_unique<TermGroup>(problem, std::move(entry.second)));
  }
  return groups;
}

TermGroupCost::TermGroupCost(const TermGroup* group) : group_(group) {
  set_num_residuals(group->num_columns() + 1);
  *mutable_parameter_block_sizes() =
      std::vector<int32_t>(group->block_sizes().begin(), group->block_sizes().end());
}

bool TermGroupCost::Evaluate(double const* const* parameters, double* residuals,
                             double** jacobians) const {
  GroupEquations equations;
  if (!group_->Evaluate(parameters, jacobians != nullptr, &equations)) return false;
  const int n = group_->num_columns();
  Eigen::Map<Eigen::VectorXd> mapped(residuals, n + 1);
  mapped.setZero();
  mapped[n] = std::sqrt(equations.cost);
  if (jacobians == nullptr) return true;

  // H = P^T L D L^T P, so that e = D^-1/2 L^-1 P g and de^T = P^T L D^1/2.
  const Eigen::LDLT<Eigen::MatrixXd> factor(equations.information);
  Eigen::MatrixXd root = factor.matrixL();
  Eigen::VectorXd reduced = factor.transpositionsP() * equations.gradient;
  factor.matrixL().solveInPlace(reduced);
  const Eigen::VectorXd pivots = factor.vectorD();
  const double min_pivot = kMinPivotShare * std::max(0.0, pivots.maxCoeff());
  for (int i = 0; i < n; ++i) {
    const double scale = pivots[i] > min_pivot ? std::sqrt(pivots[i]) : 0.0;
    root.col(i) *= scale;
    mapped[i] = scale > 0.0 ? reduced[i] / scale : 0.0;
  }
  root = factor.transpositionsP().transpose() * root;
  mapped[n] = std::sqrt(std::max(0.0, equations.cost - mapped.head(n).squaredNorm()));
  int column = 0;
  for (std::size_t b = 0; b < group_->block_sizes().size(); ++b) {
    const int size = group_->block_sizes()[b];
    if (jacobians[b] != nullptr) {
      using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
      Eigen::Map<RowMajor> jacobian(jacobians[b], n + 1, size);
      jacobian.topRows(n) = root.middleRows(column, size).transpose();
      jacobian.row(n).setZero();
    }
    column += size;
  }
  return true;
}

}  // namespace scenecalib
