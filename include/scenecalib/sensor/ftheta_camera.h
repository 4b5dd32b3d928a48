#pragma once

#include "scenecalib/sensor/angular_projection.h"
#include "scenecalib/sensor/camera_model.h"

namespace scenecalib {

/// The f-theta camera of Appendix B: u = f(s_f theta) d + u_0 with f(x) = sum k_i x^i, i = 1..5,
/// theta = atan2(|p_xy|, p_z) and d = p_xy / |p_xy|. Valid up to theta = pi, or to where f stops
/// increasing; that must not happen inside the image. The inverse starts from the paper's
/// approximate inverse polynomial, divided by s_f, and is polished by Newton.
class FthetaCamera : public CameraModel {
 public:
  /// See CreateCameraModel, which also checks what does not depend on the model.
  static Result<CameraModelPtr> Create(const CameraIntrinsics& intrinsics);

  std::string name() const override { return "ftheta"; }
  CameraIntrinsics intrinsics() const override { return intrinsics_; }
  std::optional<Eigen::Vector2d> ProjectTuned(const Eigen::Vector3d& point_in_camera,
                                              const TunableIntrinsics& tunable,
                                              ProjectionJacobians* jacobians) const override;
  std::optional<Eigen::Vector3d> UnprojectTuned(const Eigen::Vector2d& pixel,
                                                const TunableIntrinsics& tunable,
                                                UnprojectionJacobians* jacobians) const override;
  Result<CameraModelPtr> WithTunable(const TunableIntrinsics& tunable) const override;

 private:
  explicit FthetaCamera(const CameraIntrinsics& intrinsics);

  CameraIntrinsics intrinsics_;
  AngularProjection projection_;
};

}  // namespace scenecalib
