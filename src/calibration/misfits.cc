#include "misfits.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "radial_field.h"

namespace scenecalib {
namespace {

/// Prior of a lens: a change worth this share of the image's width at its border.
constexpr double kPriorShare = 0.01;
/// Prior of a shutter's line time: that of a slow sensor.
constexpr double kPriorLineTime_s = 1e-4;

/// A parameter of every camera beside those of the problem, and how the others follow it.
struct SideEstimate {
  Eigen::VectorXd change;
  Eigen::MatrixXd covariance;
  Eigen::MatrixXd response;  ///< of the problem's parameters
};

/// `evaluate(group, equations)` tells what a group's terms say; `prior_information` has a value for
/// each camera.
template <typename EvaluateGroup>
SideEstimate Estimate(const SolvedEquations& solved, const Eigen::VectorXd& prior_information,
                      const EvaluateGroup& evaluate) {
  const auto& groups = solved.assembled.groups;
  std::vector<SideEquations> equations(groups.size());
  std::vector<char> is_valid(groups.size(), 0);
  tbb::parallel_for(std::size_t{0}, groups.size(), [&](std::size_t g) {
    is_valid[g] = evaluate(*groups[g], &equations[g]) ? 1 : 0;
  });
  const Eigen::Index size = prior_information.size();
  Eigen::MatrixXd coupling = Eigen::MatrixXd::Zero(solved.factor.rows(), size);
  Eigen::MatrixXd information = prior_information.asDiagonal();
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
  SideEstimate estimate;
  estimate.response = -solved.factor.solve(coupling);
  const Eigen::LDLT<Eigen::MatrixXd> reduced(information +
                                             coupling.transpose() * estimate.response);
  estimate.covariance = solved.common_errors * reduced.solve(Eigen::MatrixXd::Identity(size, size));
  estimate.change = -reduced.solve(gradient);
  return estimate;
}

double StddevOf(const SideEstimate& estimate, Eigen::Index i) {
  return std::sqrt(std::max(0.0, estimate.covariance(i, i)));
}

}  // namespace

LensEstimate EstimateLenses(const SolvedEquations& solved) {
  const std::vector<CameraParameters>& cameras = *solved.problem.cameras;
  std::vector<RadialField> fields;
  Eigen::VectorXd prior_information(static_cast<Eigen::Index>(cameras.size()));
  for (const CameraParameters& camera : cameras) {
    const auto lens = static_cast<Eigen::Index>(fields.size());
    fields.emplace_back(*camera.model, camera.Intrinsics());
    // A lens that cannot change is held by any prior.
    const double by_change = std::max(1.0, fields.back().largest_px());
    prior_information[lens] = std::pow(by_change / (kPriorShare * camera.model->width_px()), 2);
  }
  SideEstimate estimate = Estimate(solved, prior_information,
                                   [&fields](const TermGroup& group, SideEquations* equations) {
                                     return group.EvaluateLenses(fields, equations);
                                   });
  LensEstimate result;
  for (std::size_t c = 0; c < fields.size(); ++c) {
    const auto lens = static_cast<Eigen::Index>(c);
    const double change = estimate.change[lens];
    result.lenses.push_back(
        {change, StddevOf(estimate, lens), std::abs(change) * fields[c].largest_px()});
  }
  result.covariance = std::move(estimate.covariance);
  result.response = std::move(estimate.response);
  return result;
}

std::vector<ShutterMisfit> EstimateShutters(const SolvedEquations& solved) {
  const auto num_cameras = static_cast<Eigen::Index>(solved.problem.cameras->size());
  const SideEstimate estimate =
      Estimate(solved, Eigen::VectorXd::Constant(num_cameras, std::pow(kPriorLineTime_s, -2)),
               [](const TermGroup& group, SideEquations* equations) {
                 return group.EvaluateShutters(equations);
               });
  std::vector<ShutterMisfit> shutters;
  for (Eigen::Index c = 0; c < num_cameras; ++c) {
    shutters.push_back({estimate.change[c], StddevOf(estimate, c)});
  }
  return shutters;
}

}  // namespace scenecalib
