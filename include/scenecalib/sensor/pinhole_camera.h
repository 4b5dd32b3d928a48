#pragma once

#include <array>

#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/sensor/monotonic_inverse.h"

namespace scenecalib {

/// The two pinhole cameras of sensor_msgs/CameraInfo, plumb_bob (k1 k2 p1 p2 k3) and
/// rational_polynomial (k1 k2 p1 p2 k3 k4 k5 k6). With (x, y) = p_xy / p_z, s = x^2 + y^2 and
/// L = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3) the distorted point is
///
///   x_d = L x + 2 p1 x y + p2 (s + 2 x^2),   y_d = L y + p1 (s + 2 y^2) + 2 p2 x y,
///
/// and u = s_f (fx, fy) * (x_d, y_d) + u_0 by element (OpenCV, calib3d). Valid up to 89 degrees off
/// the axis, or to where L r stops increasing or the map's determinant is no longer positive:
/// beyond, OpenCV's projectPoints folds points back into the image. That must not happen inside it.
class PinholeCamera : public CameraModel {
 public:
  /// See CreateCameraModel, which also checks what does not depend on the model.
  static Result<CameraModelPtr> Create(const CameraIntrinsics& intrinsics);

  std::string name() const override { return intrinsics_.model; }
  CameraIntrinsics intrinsics() const override { return intrinsics_; }
  std::optional<Eigen::Vector2d> ProjectTuned(const Eigen::Vector3d& point_in_camera,
                                              const TunableIntrinsics& tunable,
                                              ProjectionJacobians* jacobians) const override;
  std::optional<Eigen::Vector3d> UnprojectTuned(const Eigen::Vector2d& pixel,
                                                const TunableIntrinsics& tunable,
                                                UnprojectionJacobians* jacobians) const override;
  Result<CameraModelPtr> WithTunable(const TunableIntrinsics& tunable) const override;

 private:
  explicit PinholeCamera(const CameraIntrinsics& intrinsics);

  /// L r, the radial part of the distortion, and its derivative by r.
  double DistortedRadius(double r, double* derivative) const;
  /// The distorted point of an undistorted one, and the derivative of one by the other.
  Eigen::Vector2d Distort(const Eigen::Vector2d& xy, Eigen::Matrix2d* distorted_by_xy) const;
  /// Inverse of Distort, with the derivative of Distort there; false outside the domain.
  bool Undistort(const Eigen::Vector2d& distorted, Eigen::Vector2d* xy,
                 Eigen::Matrix2d* distorted_by_xy) const;

  CameraIntrinsics intrinsics_;
  Eigen::Array2d focal_px_;
  std::array<double, 8> k_ = {};  ///< k1 k2 p1 p2 k3 k4 k5 k6
  double max_radius_ = 0.0;       ///< largest undistorted radius of the domain
  double max_distorted_radius_ = 0.0;
  ApproximateInverse approximate_inverse_;  ///< of DistortedRadius
};

}  // namespace scenecalib
