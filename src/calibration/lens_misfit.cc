#include "lens_misfit.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "radial_field.h"

namespace scenecalib {
namespace {

/// Prior of a lens: a change worth this share of the image's width at its border.
constexpr double kPriorShare = 0.01;

}  // namespace

LensEstimate EstimateLenses(const CalibrationProblem& problem, const AssembledProblem& assembled,
                            const std::map<const double*, Eigen::Index>& first_columns,
                            const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>& factor,
                            double common_errors) {
  const auto num_lenses = static_cast<Eigen::Index>(problem.cameras->size());
  std::vector<RadialField> fields;
  for (const CameraParameters& camera : *problem.cameras) {
    fields.emplace_back(*camera.model, camera.Intrinsics());
  }
  std::vector<LensEquations> equations(assembled.groups.size());
  std::vector<char> is_valid(assembled.groups.size(), 0);
  tbb::parallel_for(std::size_t{0}, assembled.groups.size(), [&](std::size_t g) {
    is_valid[g] = assembled.groups[g]->EvaluateLenses(fields, &equations[g]) ? 1 : 0;
  });
  Eigen::MatrixXd coupling = Eigen::MatrixXd::Zero(factor.rows(), num_lenses);
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(num_lenses, num_lenses);
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(num_lenses);
  for (std::size_t g = 0; g < equations.size(); ++g) {
    if (is_valid[g] == 0) continue;
    information += equations[g].information;
    gradient += equations[g].gradient;
    Eigen::Index row = 0;
    const TermGroup& group = *assembled.groups[g];
    for (std::size_t b = 0; b < group.blocks().size(); ++b) {
      const int size = group.block_sizes()[b];
      coupling.middleRows(first_columns.at(group.blocks()[b]), size) +=
          equations[g].coupling.middleRows(row, size);
      row += size;
    }
  }
  for (Eigen::Index c = 0; c < num_lenses; ++c) {
    const auto lens = static_cast<std::size_t>(c);
    // A lens that cannot change is held by any prior.
    const double prior_px = kPriorShare * (*problem.cameras)[lens].model->width_px();
    const double by_change = std::max(1.0, fields[lens].largest_px());
    information(c, c) += std::pow(by_change / prior_px, 2);
  }
  LensEstimate estimate;
  estimate.response = -factor.solve(coupling);
  const Eigen::LDLT<Eigen::MatrixXd> reduced(information +
                                             coupling.transpose() * estimate.response);
  estimate.covariance =
      common_errors * reduced.solve(Eigen::MatrixXd::Identity(num_lenses, num_lenses));
  const Eigen::VectorXd change = -reduced.solve(gradient);
  for (Eigen::Index c = 0; c < num_lenses; ++c) {
    const auto lens = static_cast<std::size_t>(c);
    estimate.lenses.push_back({change[c], std::sqrt(std::max(0.0, estimate.covariance(c, c))),
                               std::abs(change[c]) * fields[lens].largest_px()});
  }
  return estimate;
}

}  // namespace scenecalib
