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
/// see PoseSpline::Basis), kNumGlobals common parameters and, if asked for, the lasers' errors
/// (LaserCorrection::Add) at the end, with the planes eliminated.
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

  explicit RefinementSystem(int num_controls, int num_laser_unknowns = 0);

  /// Point-to-plane terms of the chosen patches; `use` has one flag per patch. They say nothing
  /// along degenerate directions. With laser unknowns the patches' observations are by laser.
  void AddPatches(const PoseSpline& spline, const std::vector<PlanePatch>& patches,
                  const std::vector<bool>& use, const DegenerateDirections& degenerate);

  /// A residual r (3) with r(x + dx) = r + sum_j pose[j] dx_{first+j} + global dx_global, weighted.
  void AddResidual(int first, const std::array<Eigen::Matrix<double, 3, kPose>, 4>& pose,
                   const GlobalJacobian& global, const Eigen::Vector3d& residual,
                   const Eigen::Vector3d& weight);

  /// weight / 2 (x + residual)^2 of one unknown.
  void AddPrior(int unknown, double residual, double weight);

  /// Holds back steps of the lasers' errors that the data say little of, by that share of what they
  /// say of a laser on average, and keeps their mean.
  void AddLaserPriors(const LaserCorrection& lasers, double share_of_information);

  int num_unknowns() const { return laser_offset() + num_laser_unknowns_; }
  int global_offset() const { return kPose * num_controls_; }
  int laser_offset() const { return global_offset() + kNumGlobals; }

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
    /// Of the lasers alone, node by node: with itself, with the next.
    std::vector<std::array<Eigen::Matrix3d, 2>> lasers;

    void Resize(int num_controls, int num_unknowns, int num_laser_unknowns);
  };
  /// What an observation needs to apply its patch's coupling.
  struct Coupling {
    int first = 0;
    std::array<double, 4> weight{};
    Eigen::Matrix<double, 3, 6> plane_by_pose;
    LaserCorrection::Place lasers;
    Eigen::Vector3d distance_by_laser = Eigen::Vector3d::Zero();
    Eigen::Vector3d plane_by_distance = Eigen::Vector3d::Zero();
  };
  struct PatchTerm {
    std::size_t begin = 0;
    std::size_t end = 0;
    Eigen::Matrix3d inverse_information;
  };

  void AddPatch(const PoseSpline& spline, const PlanePatch& patch,
                const DegenerateDirections& degenerate, Band* band,
                std::vector<Coupling>* couplings, std::vector<PatchTerm>* terms) const;
  static void AddToPoses(const Coupling& coupling, const Vector6d& by_pose, Eigen::VectorXd* sum);
  void AddToLasers(const Coupling& coupling, double by_distance, Eigen::VectorXd* sum) const;
  double DistanceByLasers(const Coupling& coupling, const Eigen::VectorXd& x) const;
  Eigen::SparseMatrix<double> FixedPlaneMatrix() const;
  Eigen::VectorXd ApplyCoupling(const Eigen::VectorXd& x) const;

  int num_controls_;
  int num_laser_unknowns_;
  Band band_;
  std::vector<Eigen::Matrix<double, kPose, kNumGlobals>> border_;
  Eigen::Matrix<double, kNumGlobals, kNumGlobals> corner_;
  std::vector<Eigen::Triplet<double>> priors_;  ///< of the lower triangle
  /// Patches in a fixed number of chunks: the unit of parallel work and of ordered sums.
  static constexpr std::size_t kNumChunks = 16;
  std::array<std::vector<Coupling>, kNumChunks> couplings_;
  std::array<std::vector<PatchTerm>, kNumChunks> terms_;
};

}  // namespace scenecalib
