#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/geometry/trajectory.h"

namespace scenecalib {

/// A pose of a smooth motion with its derivatives.
struct SplineState {
  Rigid3 map_from_lidar;
  Eigen::Vector3d angular_velocity_in_lidar = Eigen::Vector3d::Zero();  ///< rad/s
  Eigen::Vector3d acceleration_in_map = Eigen::Vector3d::Zero();        ///< m/s^2
};

/// Uniform cubic B-spline on SO(3) x R^3 (cumulative form for the rotation; Sommer et al.,
/// "Efficient Derivative Computation for Cumulative B-Splines on Lie Groups", CVPR 2020):
/// map_from_lidar(t) with continuous velocity and acceleration. Between two knots four control
/// poses matter.
class PoseSpline {
 public:
  /// Weights of the four control poses of a time, with time derivatives, for linearisation:
  /// perturbing control pose k by Exp(phi_k), tau_k on the left moves the pose at t by
  /// sum_j weight[j] (phi, tau)_{first + j}. Exact for the translation; for the rotation it
  /// neglects the angle between neighbouring control poses (0.03 rad in a hard turn), which costs a
  /// solver nothing but a slightly slower convergence.
  struct Basis {
    int first = 0;
    std::array<double, 4> weight{};
    std::array<double, 4> velocity{};      ///< 1/s
    std::array<double, 4> acceleration{};  ///< 1/s^2
  };

  PoseSpline() = default;
  /// Spline over the trajectory's time whose control poses are the trajectory at the knots, held
  /// constant-velocity beyond its ends.
  PoseSpline(const Trajectory& map_from_lidar, double knot_interval_s);

  Timestamp start_ns() const { return start_ns_; }
  Timestamp end_ns() const { return end_ns_; }
  double knot_interval_s() const { return knot_interval_s_; }
  std::vector<Rigid3>& controls() { return controls_; }
  const std::vector<Rigid3>& controls() const { return controls_; }

  /// Times are seconds since start_ns(), in [0, end].
  Basis BasisAt(double seconds) const;
  Rigid3 PoseAt(double seconds) const;
  SplineState StateAt(double seconds) const;

  /// Dense samples over [start_ns, end_ns], at most step_s apart.
  std::vector<TimedPose> Sample(double step_s) const;

 private:
  Timestamp start_ns_ = 0;
  Timestamp end_ns_ = 0;
  double knot_interval_s_ = 0.05;
  std::vector<Rigid3> controls_;
};

}  // namespace scenecalib
