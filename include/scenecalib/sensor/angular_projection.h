#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "scenecalib/sensor/monotonic_inverse.h"

namespace scenecalib {

/// The radial part shared by ftheta and equidistant: a ray at angle theta from the optical axis
/// falls on the image plane at q = h(a theta) d, where d = p_xy / |p_xy|, theta = atan2(|p_xy|,
/// p_z) and h is a polynomial without constant term that increases up to max_argument().
///
/// Differs from the paper: Eq. (9) takes theta = atan(|p_xy / p_z|), which folds at 90 degrees.
class AngularProjection {
 public:
  static constexpr int kMaxDegree = 9;

  /// h(x) = sum coefficients[i] x^(i+1); coefficients[0] must be positive. The domain ends where h
  /// stops increasing or at `cap_rad`. The approximate inverse is fitted up to `fit_radius`.
  AngularProjection(const std::vector<double>& coefficients, double cap_rad, double fit_radius);

  /// Where h stops increasing, or the cap.
  double max_argument() const { return max_argument_; }
  /// h(max_argument()).
  double max_radius() const { return max_radius_; }

  struct ImagePoint {
    Eigen::Vector2d q;
    Eigen::Matrix<double, 2, 3> q_by_point;
    Eigen::Vector2d q_by_a;
  };
  /// False outside the domain: at the origin, on the backward axis, at a * theta > max_argument().
  /// Derivatives only on request.
  bool Project(const Eigen::Vector3d& point, double a, bool derivatives, ImagePoint* result) const;

  struct Ray {
    Eigen::Vector3d direction;  ///< unit
    Eigen::Matrix<double, 3, 2> ray_by_q;
    Eigen::Vector3d ray_by_a;
  };
  /// False beyond max_radius() or where theta would exceed pi.
  bool Unproject(const Eigen::Vector2d& q, double a, bool derivatives, Ray* result) const;

  /// h and, on request, its derivative, by Horner's rule.
  double operator()(double x, double* derivative) const {
    double value = 0.0;
    double slope = 0.0;
    for (int i = degree_ - 1; i >= 0; --i) {
      slope = slope * x + value;
      value = value * x + coefficients_[i];
    }
    if (derivative != nullptr) *derivative = slope * x + value;
    return value * x;
  }

 private:
  std::array<double, kMaxDegree> coefficients_ = {};
  int degree_ = 0;
  double max_argument_ = 0.0;
  double max_radius_ = 0.0;
  ApproximateInverse approximate_inverse_;
};

}  // namespace scenecalib
