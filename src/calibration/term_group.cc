#include "term_group.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <optional>
#include <tuple>
#include <utility>

namespace scenecalib {
namespace {

constexpr Timestamp kSecond_ns = 1000000000;
/// Edge of the pieces of surface whose errors are taken as independent.
constexpr double kSurfacePiece_m = 4.0;
/// Terms of a group that one thread sums up: a fixed share, so that the sum has a fixed order.
constexpr std::size_t kMinTermsPerSlice = 1000;
constexpr std::size_t kMaxSlices = 8;

int SourceSecond(const TransferTerm& term, const CalibrationProblem& problem) {
  if (!problem.free.correction) return 0;
  return static_cast<int>(term.source_place.index * problem.correction->knot_spacing_s());
}

/// One group for every value of a key, in its order.
template <typename KeyOf>
std::vector<std::unique_ptr<TermGroup>> GroupTermsBy(const CalibrationProblem& problem,
                                                     const KeyOf& key_of) {
  std::map<decltype(key_of(problem.terms[0])), std::vector<int>> by_key;
  for (std::size_t i = 0; i < problem.terms.size(); ++i) {
    by_key[key_of(problem.terms[i])].push_back(static_cast<int>(i));
  }
  std::vector<const std::vector<int>*> terms;
  for (const auto& entry : by_key) terms.push_back(&entry.second);
  std::vector<std::unique_ptr<TermGroup>> groups(terms.size());
  tbb::parallel_for(std::size_t{0}, groups.size(), [&](std::size_t g) {
    groups[g] = std::make_unique<TermGroup>(problem, *terms[g]);
  });
  return groups;
}

}  // namespace

/// The values that a group's terms are evaluated at, and the views' poses there.
struct TermGroup::State {
  std::vector<CameraParameters> cameras;
  std::vector<ViewPose> poses;
  std::vector<SourceRay> rays;
  std::vector<ViewColumns> columns;  ///< empty unless derivatives are asked for
};

TermGroup::TermGroup(const CalibrationProblem& problem, const std::vector<int>& terms)
    : problem_(problem),
      camera_columns_(problem.cameras->size()),
      knot_columns_(problem.correction->knots().size(), -1) {
  struct Place {
    int source = 0;
    int target = 0;
    int ray = 0;
    int term = 0;
  };
  ViewIndex index(&views_);
  std::vector<Place> places;
  places.reserve(terms.size());
  for (const int i : terms) {
    const TransferTerm& term = problem.terms[i];
    places.push_back({index.IndexOf(term.source_camera, term.source, term.source_place),
                      index.IndexOf(term.target_camera, term.target, term.target_place),
                      IndexOfRay(term, &rays_), i});
  }
  std::sort(places.begin(), places.end(), [](const Place& a, const Place& b) {
    return std::tie(a.source, a.target, a.term) < std::tie(b.source, b.target, b.term);
  });
  entries_.reserve(places.size());
  for (const Place& place : places) {
    const TransferTerm& term = problem.terms[place.term];
    entries_.push_back({term.target.pixel, term.plane_point_in_map_m, term.plane_normal_in_map,
                        term.whitening / problem.residual_sigma, place.source, place.target,
                        place.ray});
  }
  // Blocks in a fixed order: cameras, then knots.
  std::vector<bool> has_camera(problem.cameras->size(), false);
  for (const TermView& view : views_) has_camera[view.camera] = true;
  for (std::size_t c = 0; c < has_camera.size(); ++c) {
    if (has_camera[c]) AddCamera(static_cast<int>(c));
  }
  if (problem.free.correction) AddKnots();
  if (!terms.empty()) target_second_ = problem.terms[terms[0]].target_stamp_ns / kSecond_ns;
}

int TermGroup::AddBlock(double* values, int size) {
  blocks_.push_back(values);
  block_sizes_.push_back(size);
  num_columns_ += size;
  return num_columns_ - size;
}

void TermGroup::AddCamera(int camera) {
  CameraParameters& parameters = (*problem_.cameras)[camera];
  ViewColumns::Blocks& columns = camera_columns_[camera];
  const FreeParameters& free = problem_.free;
  if (free.rotation) columns.rotation = AddBlock(parameters.rotation_delta_rad.data(), 3);
  if (free.translation) columns.translation = AddBlock(parameters.translation_delta_m.data(), 3);
  if (free.intrinsics) columns.intrinsics = AddBlock(parameters.intrinsics.data(), 3);
  if (free.time_offset) columns.time_offset = AddBlock(&parameters.time_offset_delta_s, 1);
}

void TermGroup::AddKnots() {
  std::vector<bool> has_knot(knot_columns_.size(), false);
  for (const TermView& view : views_) {
    has_knot[view.place.index] = true;
    has_knot[view.place.index + 1] = true;
  }
  for (std::size_t k = 0; k < has_knot.size(); ++k) {
    if (has_knot[k]) knot_columns_[k] = AddBlock(problem_.correction->knots()[k].data(), 6);
  }
}

TermGroup::State TermGroup::StateAt(double const* const* values, bool with_derivatives) const {
  State state;
  state.cameras = *problem_.cameras;
  std::vector<const double*> value_of_column(num_columns_);
  int column = 0;
  for (std::size_t i = 0; i < blocks_.size(); ++i) {
    value_of_column[column] = values[i];
    column += block_sizes_[i];
  }
  const auto read = [&value_of_column](int first, int size, double* out) {
    if (first >= 0) std::copy_n(value_of_column[first], size, out);
  };
  for (std::size_t c = 0; c < state.cameras.size(); ++c) {
    read(camera_columns_[c].rotation, 3, state.cameras[c].rotation_delta_rad.data());
    read(camera_columns_[c].translation, 3, state.cameras[c].translation_delta_m.data());
    read(camera_columns_[c].intrinsics, 3, state.cameras[c].intrinsics.data());
    read(camera_columns_[c].time_offset, 1, &state.cameras[c].time_offset_delta_s);
  }
  const std::vector<Vector6d>& knots = problem_.correction->knots();
  const auto knot = [&](int k) -> Vector6d {
    return knot_columns_[k] < 0
               ? knots[k]
               : Vector6d(Eigen::Map<const Vector6d>(value_of_column[knot_columns_[k]]));
  };
  state.rays = RaysOf(rays_, state.cameras, with_derivatives);
  state.poses.reserve(views_.size());
  if (with_derivatives) state.columns.reserve(views_.size());
  for (const TermView& view : views_) {
    Vector6d correction = Vector6d::Zero();
    if (!knots.empty()) {
      correction = (1.0 - view.place.fraction) * knot(view.place.index) +
                   view.place.fraction * knot(view.place.index + 1);
    }
    const CameraParameters& camera = state.cameras[view.camera];
    state.poses.push_back(PoseOf(view.view, camera, correction));
    if (!with_derivatives) continue;
    ViewColumns::Blocks blocks = camera_columns_[view.camera];
    if (problem_.free.correction) {
      blocks.knots[0] = knot_columns_[view.place.index];
      blocks.knots[1] = knot_columns_[view.place.index + 1];
    }
    state.columns.emplace_back(MotionOf(view.view, camera, correction), view.view.twist_in_lidar,
                               view.place.fraction, blocks);
  }
  return state;
}

bool TermGroup::EvaluateSlice(const State& state, std::size_t first, std::size_t last,
                              bool with_derivatives, GroupEquations* equations) const {
  const double loss_square = problem_.loss_scale * problem_.loss_scale;
  ViewPairSums sums(state.columns, with_derivatives ? num_columns_ : 0);
  for (std::size_t i = first; i < last; ++i) {
    const Entry& entry = entries_[i];
    Eigen::Vector2d residual_px;
    PoseJacobians jacobians;
    if (!EvaluatePosedTransfer(state.rays[entry.ray], state.poses[entry.source], entry.target_pixel,
                               state.cameras[views_[entry.target].camera],
                               state.poses[entry.target], entry.plane_point_in_map_m,
                               entry.plane_normal_in_map, &residual_px,
                               with_derivatives ? &jacobians : nullptr)) {
      return false;
    }
    const double square = (entry.whitening * residual_px).squaredNorm() / loss_square;
    equations->cost += loss_square * std::log1p(square);  // Cauchy
    if (!with_derivatives) continue;
    sums.StartPair(entry.source, entry.target);
    sums.Add(jacobians, residual_px, entry.whitening * std::sqrt(1.0 / (1.0 + square)));
  }
  if (!with_derivatives) return true;
  sums.Finish();
  equations->information = sums.half_information();
  equations->gradient = sums.gradient();
  return true;
}

bool TermGroup::EvaluateMisfits(const std::vector<RadialField>& fields,
                                MisfitEquations* equations) const {
  using Derivatives = Eigen::Matrix<double, 2, kNumMisfits>;
  using Square = Eigen::Matrix<double, kNumMisfits, kNumMisfits>;
  const double loss_square = problem_.loss_scale * problem_.loss_scale;
  const State state = StateAt(blocks_.data(), true);
  const auto size = kNumMisfits * static_cast<Eigen::Index>(state.cameras.size());
  equations->coupling = Eigen::MatrixXd::Zero(num_columns_, size);
  equations->information = Eigen::MatrixXd::Zero(size, size);
  equations->gradient = Eigen::VectorXd::Zero(size);
  // Turn and shift of each view's camera in a second.
  std::vector<Vector6d> rates;
  for (const ViewColumns& view : state.columns) {
    rates.push_back(view.motion.rightCols<6>() * view.twist_in_lidar);
  }
  const auto field_of = [&](int view) -> const RadialField& {
    return fields[static_cast<std::size_t>(views_[view].camera)];
  };
  std::vector<std::optional<ViewPairSums>> sums(static_cast<std::size_t>(size));
  for (const Entry& entry : entries_) {
    const int source = views_[entry.source].camera;
    const int target = views_[entry.target].camera;
    Eigen::Vector2d residual_px;
    PoseJacobians jacobians;
    if (!EvaluatePosedTransfer(state.rays[entry.ray], state.poses[entry.source], entry.target_pixel,
                               state.cameras[target], state.poses[entry.target],
                               entry.plane_point_in_map_m, entry.plane_normal_in_map, &residual_px,
                               &jacobians)) {
      return false;
    }
    const double square = (entry.whitening * residual_px).squaredNorm() / loss_square;
    const Eigen::Matrix2d weight = entry.whitening * std::sqrt(1.0 / (1.0 + square));
    // A lens that bends more sends the source pixel's ray elsewhere, and shows the point elsewhere.
    const Eigen::Vector2d& source_px = rays_[entry.ray].pixel;
    const Eigen::Vector2d source_rate = jacobians.source.leftCols<6>() * rates[entry.source];
    Derivatives of_source;
    of_source << -jacobians.by_source_pixel * field_of(entry.source).At(source_px),
        source_px.y() * source_rate, source_rate;
    const Eigen::Vector2d target_rate = jacobians.target.leftCols<6>() * rates[entry.target];
    Derivatives of_target;
    of_target << field_of(entry.target).At(entry.target_pixel + residual_px),
        entry.target_pixel.y() * target_rate, target_rate;
    const auto add = [&](int camera, const Derivatives& derivatives) {
      const Eigen::Index first = kNumMisfits * camera;
      for (int k = 0; k < kNumMisfits; ++k) {
        auto& of_misfit = sums[static_cast<std::size_t>(first + k)];
        if (!of_misfit) of_misfit.emplace(state.columns, num_columns_);
        of_misfit->StartPair(entry.source, entry.target);
        of_misfit->Add(jacobians, derivatives.col(k), weight);
      }
      const Derivatives weighted = weight * derivatives;
      equations->gradient.segment<kNumMisfits>(first) +=
          weighted.transpose() * (weight * residual_px);
      equations->information.block<kNumMisfits, kNumMisfits>(first, first) +=
          weighted.transpose() * weighted;
    };
    if (source == target) {
      add(source, of_source + of_target);
    } else {
      add(source, of_source);
      add(target, of_target);
      const Square both = (weight * of_source).transpose() * (weight * of_target);
      equations->information.block<kNumMisfits, kNumMisfits>(kNumMisfits * source,
                                                             kNumMisfits * target) += both;
      equations->information.block<kNumMisfits, kNumMisfits>(
          kNumMisfits * target, kNumMisfits * source) += both.transpose();
    }
  }
  for (std::size_t i = 0; i < sums.size(); ++i) {
    if (!sums[i]) continue;
    sums[i]->Finish();
    equations->coupling.col(static_cast<Eigen::Index>(i)) = sums[i]->gradient();
  }
  return true;
}

bool TermGroup::Evaluate(double const* const* values, bool with_derivatives,
                         GroupEquations* equations) const {
  const State state = StateAt(values, with_derivatives);
  const std::size_t num_slices =
      std::clamp<std::size_t>(entries_.size() / kMinTermsPerSlice, 1, kMaxSlices);
  std::vector<GroupEquations> slices(num_slices);
  std::vector<char> is_valid(num_slices, 0);
  tbb::parallel_for(std::size_t{0}, num_slices, [&](std::size_t s) {
    is_valid[s] =
        EvaluateSlice(state, entries_.size() * s / num_slices,
                      entries_.size() * (s + 1) / num_slices, with_derivatives, &slices[s])
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
  if (with_derivatives) {
    equations->information += equations->information.transpose().eval();
  }
  return true;
}

std::vector<std::unique_ptr<TermGroup>> GroupTerms(const CalibrationProblem& problem) {
  return GroupTermsBy(problem, [&problem](const TransferTerm& term) {
    return std::make_pair(term.target_stamp_ns / kSecond_ns, SourceSecond(term, problem));
  });
}

std::vector<std::unique_ptr<TermGroup>> GroupTermsBySurface(const CalibrationProblem& problem) {
  return GroupTermsBy(problem, [](const TransferTerm& term) {
    int axis = 0;
    term.plane_normal_in_map.cwiseAbs().maxCoeff(&axis);
    const Eigen::Vector3i cube =
        (term.plane_point_in_map_m / kSurfacePiece_m).array().floor().cast<int>();
    return std::array<int, 4>{cube.x(), cube.y(), cube.z(),
                              term.plane_normal_in_map[axis] > 0.0 ? axis : axis + 3};
  });
}

}  // namespace scenecalib
