#include "misfits.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "radial_field.h"

namespace scenecalib {
namespace {

/// Prior of a lens: a change worth this share of the image's width at its border.
constexpr double kPriorShare = 0.01;
/// Priors of what a rig file may not say: the line time of a slow sensor, a clock that nobody set.
constexpr double kPriorLineTime_s = 1e-4;
constexpr double kPriorTimeOffset_s = 0.05;
constexpr double kHeldTimeOffset_s = 1e-9;

constexpr Eigen::Index kLens = 0;
constexpr Eigen::Index kLineTime = 1;
constexpr Eigen::Index kTimeOffset = 2;
constexpr Eigen::Index kNumMisfits = TermGroup::kNumMisfits;

/// The misfits' information by their priors.
Eigen::VectorXd PriorInformation(const CalibrationProblem& problem,
                                 const std::vector<RadialField>& fields) {
  Eigen::VectorXd information(kNumMisfits * static_cast<Eigen::Index>(fields.size()));
  for (std::size_t c = 0; c < fields.size(); ++c) {
    // A lens that cannot change is held by any prior.
    const double lens_px = kPriorShare * (*problem.cameras)[c].model->width_px();
    const double by_change = std::max(1.0, fields[c].largest_px());
    const auto first = kNumMisfits * static_cast<Eigen::Index>(c);
    information[first + kLens] = std::pow(by_change / lens_px, 2);
    information[first + kLineTime] = std::pow(kPriorLineTime_s, -2);
    information[first + kTimeOffset] =
        std::pow(problem.free.time_offset ? kHeldTimeOffset_s : kPriorTimeOffset_s, -2);
  }
  return information;
}

}  // namespace

MisfitEstimate EstimateMisfits(const SolvedEquations& solved) {
  std::vector<RadialField> fields;
  for (const CameraParameters& camera : *solved.problem.cameras) {
    fields.emplace_back(*camera.model, camera.Intrinsics());
  }
  const auto& groups = solved.assembled.groups;
  std::vector<MisfitEquations> equations(groups.size());
  std::vector<char> is_valid(groups.size(), 0);
  tbb::parallel_for(std::size_t{0}, groups.size(), [&](std::size_t g) {
    is_valid[g] = groups[g]->EvaluateMisfits(fields, &equations[g]) ? 1 : 0;
  });
  Eigen::MatrixXd information = PriorInformation(solved.problem, fields).asDiagonal();
  const Eigen::Index size = information.rows();
  Eigen::MatrixXd coupling = Eigen::MatrixXd::Zero(solved.factor.rows(), size);
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(size);
  for (std::size_t g = 0; g < equations.size(); ++g) {
    if (is_valid[g] == 0) continue;
    information += equations[g].information;
    gradient += equations[g].gradient;
    Eigen::Index row = 0;
    for (std::size_t b = 0; b < groups[g]->blocks().size(); ++b) {
      const int block_size = groups[g]->block_sizes()[b];
      coupling.middleRows(solved.first_columns.at(groups[g]->blocks()[b]), block_size) +=
          equations[g].coupling.middleRows(row, block_size);
      row += block_size;
    }
  }
  MisfitEstimate estimate;
  estimate.response = -solved.factor.solve(coupling);
  const Eigen::LDLT<Eigen::MatrixXd> reduced(information +
                                             coupling.transpose() * estimate.response);
  estimate.covariance = solved.common_errors * reduced.solve(Eigen::MatrixXd::Identity(size, size));
  const Eigen::VectorXd change = -reduced.solve(gradient);
  const Eigen::VectorXd stddev = estimate.covariance.diagonal().cwiseMax(0.0).cwiseSqrt();
  for (std::size_t c = 0; c < fields.size(); ++c) {
    const auto first = kNumMisfits * static_cast<Eigen::Index>(c);
    const double lens = change[first + kLens];
    estimate.lenses.push_back(
        {lens, stddev[first + kLens], std::abs(lens) * fields[c].largest_px()});
    estimate.clocks.push_back({change[first + kLineTime], stddev[first + kLineTime],
                               change[first + kTimeOffset], stddev[first + kTimeOffset]});
  }
  return estimate;
}

Eigen::MatrixXd MisfitEstimate::Errors(bool lenses_follow) const {
  Eigen::MatrixXd errors = Eigen::MatrixXd::Zero(covariance.rows(), covariance.cols());
  const auto excess = [](double change, double stddev) {
    return std::max(0.0, change * change - stddev * stddev);
  };
  const auto num_cameras = static_cast<Eigen::Index>(lenses.size());
  for (Eigen::Index i = 0; i < num_cameras; ++i) {
    const RadialMisfit& lens = lenses[static_cast<std::size_t>(i)];
    const ClockMisfit& clock = clocks[static_cast<std::size_t>(i)];
    const Eigen::Index at = kNumMisfits * i;
    errors(at + kLens, at + kLens) = excess(lens.change, lens.stddev);
    errors(at + kLineTime, at + kLineTime) =
        excess(clock.line_time_change_s, clock.line_time_stddev_s);
    errors(at + kTimeOffset, at + kTimeOffset) =
        excess(clock.time_offset_change_s, clock.time_offset_stddev_s);
  }
  if (!lenses_follow) return errors;
  for (Eigen::Index i = 0; i < num_cameras; ++i) {
    for (Eigen::Index j = 0; j < num_cameras; ++j) {
      const Eigen::Index row = kNumMisfits * i + kLens;
      const Eigen::Index column = kNumMisfits * j + kLens;
      errors(row, column) = covariance(row, column);
    }
  }
  return errors;
}

}  // namespace scenecalib
