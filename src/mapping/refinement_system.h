#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <array>
#include <vector>

#include "degenerate_directions.h"
#include "plane_patches.h"
#include "scenecalib/mapping/pose_spline.h"

namespace scenecalib {

/// Which measurements count: both halves of an even split see the same time.
enum class DataSubset { kAll, kEven, kOdd };

/// One Gauss-Newton step of the refinement: the normal equations over control poses (tau, phi each,
/// see PoseSpline::Basis) and kNumGlobals common parameters at the end, with the planes eliminated.
/// The planes couple every time that saw them, so the reduced matrix is nearly full; it is applied
/// without being formed, in conjugate gradients preconditioned by the banded matrix of fixed
/// planes.
class RefinementSystem {
 public:
  /// Gyroscope bias, accelerometer bias, gravity (3 each), odometry scale.
  static constexpr int kNumGlobals = 10;
  static constexpr int kPose = 6;           ///< tau (m), phi (rad), both in the map frame
  static constexpr int kOdometryScale = 9;  ///< its index among them
  using Globals = Eigen::Matrix<double, kNumGlobals, 1>;
  using GlobalJacobian = Eigen::Matrix<double, 3, kNumGlobals>;

  explicit RefinementSystem(int num_controls);

  /// Point-to-plane terms of the chosen patches; `use` has one flag per patch. They say nothing
  /// along degenerate directions.
  void AddPatches(const PoseSpline& spline, const std::vector<PlanePatch>& patches,
                  const std::vector<bool>& use, const DegenerateDirections& degenerate);

  /// A residual r (3) with r(x + dx) = r + sum_j pose[j] dx_{first+j} + global dx_global, weighted.
  void AddResidual(int first, const std::array<Eigen::Matrix<double, 3, kPose>, 4>& pose,
                   const GlobalJacobian& global, const Eigen::Vector3d& residual,
                   const Eigen::Vector3d& weight);

  /// weight / 2 (x + residual)^2 of one unknown.
  void AddPrior(int unknown, double residual, double weight);

  int num_unknowns() const { return kPose * num_controls_ + kNumGlobals; }
  int global_offset() const { return kPose * num_controls_; }

  struct Solution {
    Eigen::VectorXd step;
    int iterations = 0;
    bool ok = false;
  };
  Solution Solve(int max_iterations, double tolerance) const;

 private:
  using Matrix6d = Eigen::Matrix<double, 6, 6>;
  using Vector6d = Eigen::Matrix<double, 6, 1>;
  /// Normal equations of fixed planes: upper blocks (k, k + j), j in [0, 4).
  struct Band {
    std::vector<std::array<Matrix6d, 4>> blocks;
    Eigen::VectorXd gradient;
  };
  /// What an observation needs to apply its patch's coupling.
  struct Coupling {
    int first = 0;
    std::array<double, 4> weight{};
    Eigen::Matrix<double, 3, 6> plane_by_pose;
  };
  struct PatchTerm {
    std::size_t begin = 0;
    std::size_t end = 0;
    Eigen::Matrix3d inverse_information;
  };

  void AddPatch(const PoseSpline& spline, const PlanePatch& patch,
                const DegenerateDirections& degenerate, Band* band,
                std::vector<Coupling>* couplings, std::vector<PatchTerm>* terms) const;
  Eigen::SparseMatrix<double> FixedPlaneMatrix() const;
  Eigen::VectorXd ApplyCoupling(const Eigen::VectorXd& x) const;

  int num_controls_;
  Band band_;
  std::vector<Eigen::Matrix<double, kPose, kNumGlobals>> border_;
  Eigen::Matrix<double, kNumGlobals, kNumGlobals> corner_;
  std::vector<std::pair<int, double>> priors_;
  /// Patches in a fixed number of chunks: the unit of parallel work and of ordered sums.
  static constexpr std::size_t kNumChunks = 16;
  std::array<std::vector<Coupling>, kNumChunks> couplings_;
  std::array<std::vector<PatchTerm>, kNumChunks> terms_;
};

}  // namespace scenecalib
