#include "refinement_system.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace scenecalib {

RefinementSystem::RefinementSystem(int num_controls) : num_controls_(num_controls) {
  band_.blocks.resize(num_controls);
  for (auto& row : band_.blocks) row.fill(Matrix6d::Zero());
  band_.gradient = Eigen::VectorXd::Zero(num_unknowns());
  border_.assign(num_controls, Eigen::Matrix<double, kPose, kNumGlobals>::Zero());
  corner_.setZero();
}

void RefinementSystem::AddPatch(const PoseSpline& spline, const PlanePatch& patch,
                                const DegenerateDirections& degenerate, Band* band,
                                std::vector<Coupling>* couplings,
                                std::vector<PatchTerm>* terms) const {
  const Eigen::Vector3d u = patch.axes.col(0);
  const Eigen::Vector3d v = patch.axes.col(1);
  const Eigen::Vector3d normal = patch.axes.col(2);
  // A trace of information keeps a plane seen only along a line invertible.
  Eigen::Matrix3d information = Eigen::Vector3d(1e-6, 1.0, 1.0).asDiagonal();
  Eigen::Vector3d plane_gradient = Eigen::Vector3d::Zero();
  PatchTerm term;
  term.begin = couplings->size();
  for (const PatchObservation& o : patch.observations) {
    const PoseSpline::Basis basis = spline.BasisAt(o.seconds);
    Eigen::Vector3d lidar_in_map = Eigen::Vector3d::Zero();
    for (int j = 0; j < 4; ++j) {
      lidar_in_map += basis.weight[j] * spline.controls()[basis.first + j].translation;
    }
    // Distance of the points by the pose, as offset and slopes over the patch (docs/math.md).
    Eigen::Matrix<double, 3, 6> distance_by_pose;
    distance_by_pose << normal.transpose() * degenerate.Projection(o.seconds),
        (patch.center_m - lidar_in_map).cross(normal).transpose(), Eigen::RowVector3d::Zero(),
        -v.transpose(), Eigen::RowVector3d::Zero(), u.transpose();
    Coupling coupling;
    coupling.first = basis.first;
    coupling.weight = basis.weight;
    coupling.plane_by_pose = o.weight * o.information * distance_by_pose;
    const Matrix6d hessian = distance_by_pose.transpose() * coupling.plane_by_pose;
    const Vector6d gradient = o.weight * distance_by_pose.transpose() * o.gradient;
    for (int i = 0; i < 4; ++i) {
      band->gradient.segment<kPose>(kPose * (basis.first + i)) += basis.weight[i] * gradient;
      for (int j = i; j < 4; ++j) {
        band->blocks[basis.first + i][j - i] += basis.weight[i] * basis.weight[j] * hessian;
      }
    }
    information += o.weight * o.information;
    plane_gradient += o.weight * o.gradient;
    couplings->push_back(coupling);
  }
  term.end = couplings->size();
  term.inverse_information = information.inverse();
  const Eigen::Vector3d plane_step = term.inverse_information * plane_gradient;
  for (std::size_t c = term.begin; c < term.end; ++c) {
    const Coupling& coupling = (*couplings)[c];
    const Vector6d gradient = coupling.plane_by_pose.transpose() * plane_step;
    for (int j = 0; j < 4; ++j) {
      band->gradient.segment<kPose>(kPose * (coupling.first + j)) -= coupling.weight[j] * gradient;
    }
  }
  terms->push_back(term);
}

void RefinementSystem::AddPatches(const PoseSpline& spline, const std::vector<PlanePatch>& patches,
                                  const std::vector<bool>& use,
                                  const DegenerateDirections& degenerate) {
  std::array<Band, kNumChunks> bands;
  tbb::parallel_for(std::size_t{0}, kNumChunks, [&](std::size_t chunk) {
    Band& band = bands[chunk];
    band.blocks.resize(num_controls_);
    for (auto& row : band.blocks) row.fill(Matrix6d::Zero());
    band.gradient = Eigen::VectorXd::Zero(num_unknowns());
    const std::size_t begin = patches.size() * chunk / kNumChunks;
    const std::size_t end = patches.size() * (chunk + 1) / kNumChunks;
    for (std::size_t i = begin; i < end; ++i) {
      if (!use[i]) continue;
      AddPatch(spline, patches[i], degenerate, &band, &couplings_[chunk], &terms_[chunk]);
    }
  });
  for (const Band& band : bands) {
    band_.gradient += band.gradient;
    for (int k = 0; k < num_controls_; ++k) {
      for (int j = 0; j < 4; ++j) band_.blocks[k][j] += band.blocks[k][j];
    }
  }
}

void RefinementSystem::AddResidual(int first,
                                   const std::array<Eigen::Matrix<double, 3, kPose>, 4>& pose,
                                   const GlobalJacobian& global, const Eigen::Vector3d& residual,
                                   const Eigen::Vector3d& weight) {
  const Eigen::Vector3d weighted = weight.cwiseProduct(residual);
  for (int i = 0; i < 4; ++i) {
    const Eigen::Matrix<double, kPose, 3> left = pose[i].transpose() * weight.asDiagonal();
    band_.gradient.segment<kPose>(kPose * (first + i)) += pose[i].transpose() * weighted;
    border_[first + i] += left * global;
    for (int j = i; j < 4; ++j) band_.blocks[first + i][j - i] += left * pose[j];
  }
  band_.gradient.tail<kNumGlobals>() += global.transpose() * weighted;
  corner_ += global.transpose() * weight.asDiagonal() * global;
}

void RefinementSystem::AddPrior(int unknown, double residual, double weight) {
  priors_.emplace_back(unknown, weight);
  band_.gradient[unknown] += weight * residual;
}

Eigen::SparseMatrix<double> RefinementSystem::FixedPlaneMatrix() const {
  std::vector<Eigen::Triplet<double>> triplets;
  triplets.reserve(static_cast<std::size_t>(num_controls_) * kPose * (4 * kPose + kNumGlobals));
  // The lower triangle: element (column, row) of the stored upper blocks.
  for (int k = 0; k < num_controls_; ++k) {
    for (int j = 0; j < 4 && k + j < num_controls_; ++j) {
      for (int a = 0; a < kPose; ++a) {
        for (int b = j == 0 ? a : 0; b < kPose; ++b) {
          triplets.emplace_back(kPose * (k + j) + b, kPose * k + a, band_.blocks[k][j](a, b));
        }
      }
    }
    for (int a = 0; a < kPose; ++a) {
      for (int b = 0; b < kNumGlobals; ++b) {
        triplets.emplace_back(global_offset() + b, kPose * k + a, border_[k](a, b));
      }
    }
  }
  for (int a = 0; a < kNumGlobals; ++a) {
    for (int b = a; b < kNumGlobals; ++b) {
      triplets.emplace_back(global_offset() + b, global_offset() + a, corner_(a, b));
    }
  }
  for (const auto& [unknown, weight] : priors_) triplets.emplace_back(unknown, unknown, weight);
  Eigen::SparseMatrix<double> matrix(num_unknowns(), num_unknowns());
  matrix.setFromTriplets(triplets.begin(), triplets.end());
  return matrix;
}

Eigen::VectorXd RefinementSystem::ApplyCoupling(const Eigen::VectorXd& x) const {
  std::array<Eigen::VectorXd, kNumChunks> sums;
  tbb::parallel_for(std::size_t{0}, kNumChunks, [&](std::size_t chunk) {
    Eigen::VectorXd& sum = sums[chunk];
    sum = Eigen::VectorXd::Zero(x.size());
    for (const PatchTerm& term : terms_[chunk]) {
      Eigen::Vector3d plane = Eigen::Vector3d::Zero();
      for (std::size_t c = term.begin; c < term.end; ++c) {
        const Coupling& coupling = couplings_[chunk][c];
        const double* pose = x.data() + kPose * coupling.first;
        Vector6d moved = Vector6d::Zero();
        for (int j = 0; j < 4; ++j) {
          moved += coupling.weight[j] * Eigen::Map<const Vector6d>(pose + kPose * j);
        }
        plane += coupling.plane_by_pose * moved;
      }
      plane = term.inverse_information * plane;
      for (std::size_t c = term.begin; c < term.end; ++c) {
        const Coupling& coupling = couplings_[chunk][c];
        const Vector6d back = coupling.plane_by_pose.transpose() * plane;
        double* pose = sum.data() + kPose * coupling.first;
        for (int j = 0; j < 4; ++j) {
          Eigen::Map<Vector6d>(pose + kPose * j) += coupling.weight[j] * back;
        }
      }
    }
  });
  for (std::size_t chunk = 1; chunk < kNumChunks; ++chunk) sums[0] += sums[chunk];
  return sums[0];
}

RefinementSystem::Solution RefinementSystem::Solve(int max_iterations, double tolerance) const {
  Solution solution;
  solution.step = Eigen::VectorXd::Zero(num_unknowns());
  const Eigen::SparseMatrix<double> fixed = FixedPlaneMatrix();
  Eigen::SimplicialLLT<Eigen::SparseMatrix<double>, Eigen::Lower, Eigen::NaturalOrdering<int>>
      cholesky(fixed);
  if (cholesky.info() != Eigen::Success) return solution;
  Eigen::VectorXd residual = -band_.gradient;
  Eigen::VectorXd preconditioned = cholesky.solve(residual);
  Eigen::VectorXd direction = preconditioned;
  double energy = residual.dot(preconditioned);
  const double goal = tolerance * tolerance * energy;
  while (solution.iterations < max_iterations && energy > goal && energy > 0.0) {
    const Eigen::VectorXd applied =
        fixed.selfadjointView<Eigen::Lower>() * direction - ApplyCoupling(direction);
    const double curvature = direction.dot(applied);
    if (!(curvature > 0.0)) break;
    const double length = energy / curvature;
    solution.step += length * direction;
    residual -= length * applied;
    preconditioned = cholesky.solve(residual);
    const double next_energy = residual.dot(preconditioned);
    direction = preconditioned + (next_energy / energy) * direction;
    energy = next_energy;
    ++solution.iterations;
  }
  solution.ok = solution.step.allFinite();
  return solution;
}

}  // namespace scenecalib
