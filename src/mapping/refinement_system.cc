#include "refinement_system.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace scenecalib {

void RefinementSystem::Band::Resize(int num_controls, int num_unknowns, int num_laser_unknowns) {
  blocks.resize(num_controls);
  for (auto& row : blocks) row.fill(Matrix6d::Zero());
  gradient = Eigen::VectorXd::Zero(num_unknowns);
  lasers.resize(num_laser_unknowns / 3);
  for (auto& row : lasers) row.fill(Eigen::Matrix3d::Zero());
}

RefinementSystem::RefinementSystem(int num_controls, int num_laser_unknowns)
    : num_controls_(num_controls), num_laser_unknowns_(num_laser_unknowns) {
  band_.Resize(num_controls, num_unknowns(), num_laser_unknowns);
  border_.assign(num_controls, Eigen::Matrix<double, kPose, kNumGlobals>::Zero());
  corner_.setZero();
}

void RefinementSystem::AddToPoses(const Coupling& coupling, const Vector6d& by_pose,
                                  Eigen::VectorXd* sum) {
  double* pose = sum->data() + kPose * coupling.first;
  for (int j = 0; j < 4; ++j) {
    Eigen::Map<Vector6d>(pose + kPose * j) += coupling.weight[j] * by_pose;
  }
}

void RefinementSystem::AddToLasers(const Coupling& coupling, double by_distance,
                                   Eigen::VectorXd* sum) const {
  const Eigen::Vector3d by_laser = by_distance * coupling.distance_by_laser;
  double* node = sum->data() + laser_offset() + 3 * coupling.lasers.first;
  Eigen::Map<Eigen::Vector3d> first(node), next(node + 3);
  first += (1.0 - coupling.lasers.share_of_next) * by_laser;
  next += coupling.lasers.share_of_next * by_laser;
}

double RefinementSystem::DistanceByLasers(const Coupling& coupling,
                                          const Eigen::VectorXd& x) const {
  const double* node = x.data() + laser_offset() + 3 * coupling.lasers.first;
  const Eigen::Map<const Eigen::Vector3d> first(node), next(node + 3);
  return (1.0 - coupling.lasers.share_of_next) * coupling.distance_by_laser.dot(first) +
         coupling.lasers.share_of_next * coupling.distance_by_laser.dot(next);
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
    if (num_laser_unknowns_ > 0) {
      const Eigen::Vector2d mean = o.information.block<2, 1>(1, 0) / o.count();
      const Eigen::Vector3d point = patch.center_m + patch.axes.leftCols<2>() * mean - lidar_in_map;
      const Eigen::Matrix3d map_from_lidar = spline.PoseAt(o.seconds).RotationMatrix();
      coupling.lasers = o.lasers;
      coupling.distance_by_laser =
          LaserCorrection::JacobianAt(map_from_lidar.transpose() * point).transpose() *
          (map_from_lidar.transpose() * normal);
      coupling.plane_by_distance = o.weight * o.information.col(0);
      const double next = o.lasers.share_of_next;
      const Eigen::Matrix3d square = o.weight * o.count() * coupling.distance_by_laser *
                                     coupling.distance_by_laser.transpose();
      auto& row = band->lasers[o.lasers.first];
      row[0] += (1.0 - next) * (1.0 - next) * square;
      row[1] += next * (1.0 - next) * square;
      band->lasers[o.lasers.first + 1][0] += next * next * square;
      AddToLasers(coupling, o.weight * o.gradient[0], &band->gradient);
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
    if (num_laser_unknowns_ > 0) {
      AddToLasers(coupling, -coupling.plane_by_distance.dot(plane_step), &band->gradient);
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
    band.Resize(num_controls_, num_unknowns(), num_laser_unknowns_);
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
    for (std::size_t i = 0; i < band.lasers.size(); ++i) {
      for (int j = 0; j < 2; ++j) band_.lasers[i][j] += band.lasers[i][j];
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
  band_.gradient.segment<kNumGlobals>(global_offset()) += global.transpose() * weighted;
  corner_ += global.transpose() * weight.asDiagonal() * global;
}

void RefinementSystem::AddPrior(int unknown, double residual, double weight) {
  priors_.emplace_back(unknown, unknown, weight);
  band_.gradient[unknown] += weight * residual;
}

void RefinementSystem::AddLaserPriors(const LaserCorrection& lasers, double share_of_information) {
  // Means over all points: the sensor's frame is about its lasers' mean, and a turn about its axis
  // is no error.
  const LaserCorrection::Errors mean_sigma(2e-6, 1e-6, 1e-6);  // m, rad, rad
  const auto& nodes = lasers.nodes();
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  for (const auto& node : band_.lasers) information += node[0];
  // What all points would say of a laser if poses and planes were known.
  const Eigen::Vector3d weight =
      share_of_information / static_cast<double>(nodes.size()) * information.diagonal();
  LaserCorrection::Errors mean = LaserCorrection::Errors::Zero();
  for (const LaserCorrection::Node& node : nodes) mean += node.share * node.errors;
  for (int axis = 0; axis < 3; ++axis) {
    const double mean_weight = std::pow(mean_sigma[axis], -2);
    const auto unknown = [&](std::size_t node) {
      return laser_offset() + 3 * static_cast<int>(node) + axis;
    };
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      AddPrior(unknown(i), 0.0, weight[axis]);
      band_.gradient[unknown(i)] += mean_weight * nodes[i].share * mean[axis];
      for (std::size_t j = 0; j <= i; ++j) {
        priors_.emplace_back(unknown(i), unknown(j), mean_weight * nodes[i].share * nodes[j].share);
      }
    }
  }
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
  for (std::size_t i = 0; i < band_.lasers.size(); ++i) {
    const int offset = laser_offset() + 3 * static_cast<int>(i);
    for (int a = 0; a < 3; ++a) {
      for (int b = a; b < 3; ++b) {
        triplets.emplace_back(offset + b, offset + a, band_.lasers[i][0](a, b));
      }
      if (i + 1 == band_.lasers.size()) continue;
      for (int b = 0; b < 3; ++b) {
        triplets.emplace_back(offset + 3 + b, offset + a, band_.lasers[i][1](a, b));
      }
    }
  }
  triplets.insert(triplets.end(), priors_.begin(), priors_.end());
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
        if (num_laser_unknowns_ == 0) continue;
        // Beside the planes, what poses and lasers have in common; it is not in the band.
        const double distance = DistanceByLasers(coupling, x);
        plane += coupling.plane_by_distance * distance;
        AddToPoses(coupling, -coupling.plane_by_pose.row(0).transpose() * distance, &sum);
        AddToLasers(coupling, -coupling.plane_by_pose.row(0).dot(moved), &sum);
      }
      plane = term.inverse_information * plane;
      for (std::size_t c = term.begin; c < term.end; ++c) {
        const Coupling& coupling = couplings_[chunk][c];
        AddToPoses(coupling, coupling.plane_by_pose.transpose() * plane, &sum);
        if (num_laser_unknowns_ == 0) continue;
        AddToLasers(coupling, coupling.plane_by_distance.dot(plane), &sum);
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
