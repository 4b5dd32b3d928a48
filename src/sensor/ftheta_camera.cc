#include "scenecalib/sensor/ftheta_camera.h"

#include <cmath>

#include "camera_checks.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

// The polynomial's argument is s_f theta with theta <= pi; a solver may try s_f up to this.
constexpr double kMaxFocalScale = 2.0;

}  // namespace

FthetaCamera::FthetaCamera(const CameraIntrinsics& intrinsics)
    : CameraModel(intrinsics.width_px, intrinsics.height_px, intrinsics.principal_point_px),
      intrinsics_(intrinsics),
      projection_(intrinsics.polynomial_px, kMaxFocalScale * kPi,
                  FarthestCorner(intrinsics).norm()) {}

Result<CameraModelPtr> FthetaCamera::Create(const CameraIntrinsics& intrinsics) {
  SCENECALIB_RETURN_IF_ERROR(CheckCount("ftheta", "polynomial_px", intrinsics.polynomial_px, 5));
  SCENECALIB_RETURN_IF_ERROR(CheckCount("ftheta", "focal_px", intrinsics.focal_px, 0));
  SCENECALIB_RETURN_IF_ERROR(CheckCount("ftheta", "distortion", intrinsics.distortion, 0));
  SCENECALIB_RETURN_IF_ERROR(
      CheckPositive("ftheta", "polynomial_px[0]", intrinsics.polynomial_px[0]));
  std::shared_ptr<FthetaCamera> camera(new FthetaCamera(intrinsics));
  const double corner_px = FarthestCorner(intrinsics).norm();
  const double end_rad = camera->projection_.max_argument();
  const double end_px = camera->projection_.max_radius();
  // A fisheye that shows its whole circle inside the frame has corners that no ray reaches: there
  // the polynomial must increase up to pi only.
  if (end_px < corner_px && end_rad < kPi) {
    return NotMonotonic("ftheta", "polynomial_px", end_rad, end_px, corner_px);
  }
  const auto corner = camera->Unproject(intrinsics.principal_point_px + FarthestCorner(intrinsics));
  camera->max_theta_rad_ = corner ? Theta(*corner) : kPi;
  return CameraModelPtr(camera);
}

std::optional<Eigen::Vector2d> FthetaCamera::ProjectTuned(const Eigen::Vector3d& point_in_camera,
                                                          const TunableIntrinsics& tunable,
                                                          ProjectionJacobians* jacobians) const {
  AngularProjection::ImagePoint image;
  if (!projection_.Project(point_in_camera, tunable.focal_scale, jacobians != nullptr, &image)) {
    return std::nullopt;
  }
  if (jacobians != nullptr) {
    jacobians->pixel_by_point = image.q_by_point;
    jacobians->pixel_by_intrinsics << image.q_by_a, Eigen::Matrix2d::Identity();
  }
  return image.q + tunable.principal_point_px;
}

std::optional<Eigen::Vector3d> FthetaCamera::UnprojectTuned(
    const Eigen::Vector2d& pixel, const TunableIntrinsics& tunable,
    UnprojectionJacobians* jacobians) const {
  AngularProjection::Ray ray;
  if (!projection_.Unproject(pixel - tunable.principal_point_px, tunable.focal_scale,
                             jacobians != nullptr, &ray)) {
    return std::nullopt;
  }
  if (jacobians != nullptr) {
    jacobians->ray_by_pixel = ray.ray_by_q;
    jacobians->ray_by_intrinsics << ray.ray_by_a, -ray.ray_by_q;
  }
  return ray.direction;
}

Result<CameraModelPtr> FthetaCamera::WithTunable(const TunableIntrinsics& tunable) const {
  CameraIntrinsics folded = intrinsics_;
  folded.principal_point_px = tunable.principal_point_px;
  double power = 1.0;
  for (double& k : folded.polynomial_px) k *= (power *= tunable.focal_scale);
  return CreateCameraModel(folded);
}

}  // namespace scenecalib
