#pragma once

#include "scenecalib/sensor/angular_projection.h"
#include "scenecalib/sensor/camera_model.h"

namespace scenecalib {

/// The equidistant (Kannala-Brandt, OpenCV "fisheye") camera of sensor_msgs/CameraInfo: with
/// theta_d = theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9 and d = p_xy / |p_xy|,
/// u = s_f (fx, fy) * theta_d d + u_0 (by element). Unlike OpenCV's projectPoints, theta is
/// atan2(|p_xy|, p_z), so it is valid beyond 90 degrees off the axis: up to pi, or to where theta_d
/// stops increasing, which must not happen inside the image.
class EquidistantCamera : public CameraModel {
 public:
  /// See CreateCameraModel, which also checks what does not depend on the model.
  static Result<CameraModelPtr> Create(const CameraIntrinsics& intrinsics);

  std::string name() const override { return "equidistant"; }
  CameraIntrinsics intrinsics() const override { return intrinsics_; }
  std::optional<Eigen::Vector2d> ProjectTuned(const Eigen::Vector3d& point_in_camera,
                                              const TunableIntrinsics& tunable,
                                              ProjectionJacobians* jacobians) const override;
  std::optional<Eigen::Vector3d> UnprojectTuned(const Eigen::Vector2d& pixel,
                                                const TunableIntrinsics& tunable,
                                                UnprojectionJacobians* jacobians) const override;
  Result<CameraModelPtr> WithTunable(const TunableIntrinsics& tunable) const override;

 private:
  explicit EquidistantCamera(const CameraIntrinsics& intrinsics);

  CameraIntrinsics intrinsics_;
  Eigen::Array2d focal_px_;
  AngularProjection projection_;
};

}  // namespace scenecalib
