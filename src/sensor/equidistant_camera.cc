#include "scenecalib/sensor/equidistant_camera.h"

#include <cmath>

#include "camera_checks.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

std::vector<double> Polynomial(const std::vector<double>& k) {
  return {1.0, 0.0, k[0], 0.0, k[1], 0.0, k[2], 0.0, k[3]};
}

Eigen::Array2d Focal(const CameraIntrinsics& intrinsics) {
  return {intrinsics.focal_px[0], intrinsics.focal_px[1]};
}

double CornerRadius(const CameraIntrinsics& intrinsics) {
  double radius = 0.0;
  for (const Eigen::Vector2d& corner : Corners(intrinsics)) {
    radius = std::max(radius, (corner.array() / Focal(intrinsics)).matrix().norm());
  }
  return radius;
}

}  // namespace

EquidistantCamera::EquidistantCamera(const CameraIntrinsics& intrinsics)
    : CameraModel(intrinsics.width_px, intrinsics.height_px, intrinsics.principal_point_px),
      intrinsics_(intrinsics),
      focal_px_(Focal(intrinsics)),
      projection_(Polynomial(intrinsics.distortion), kPi, CornerRadius(intrinsics)) {}

Result<CameraModelPtr> EquidistantCamera::Create(const CameraIntrinsics& intrinsics) {
  SCENECALIB_RETURN_IF_ERROR(CheckFocal(intrinsics));
  SCENECALIB_RETURN_IF_ERROR(CheckCount("equidistant", "distortion", intrinsics.distortion, 4));
  SCENECALIB_RETURN_IF_ERROR(
      CheckCount("equidistant", "polynomial_px", intrinsics.polynomial_px, 0));
  std::shared_ptr<EquidistantCamera> camera(new EquidistantCamera(intrinsics));
  const double corner = CornerRadius(intrinsics);
  const double end_rad = camera->projection_.max_argument();
  const double end = camera->projection_.max_radius();
  // As for ftheta: corners outside the image circle of the whole sphere are no fault.
  if (end < corner && end_rad < kPi) {
    const double focal_px = camera->focal_px_.mean();
    return NotMonotonic("equidistant", "distortion", end_rad, end * focal_px, corner * focal_px);
  }
  for (const Eigen::Vector2d& offset : Corners(intrinsics)) {
    const auto ray = camera->Unproject(intrinsics.principal_point_px + offset);
    camera->max_theta_rad_ = std::max(camera->max_theta_rad_, ray ? Theta(*ray) : kPi);
  }
  return CameraModelPtr(camera);
}

std::optional<Eigen::Vector2d> EquidistantCamera::ProjectTuned(
    const Eigen::Vector3d& point_in_camera, const TunableIntrinsics& tunable,
    ProjectionJacobians* jacobians) const {
  if (!(tunable.focal_scale > 0.0)) return std::nullopt;
  AngularProjection::ImagePoint image;
  if (!projection_.Project(point_in_camera, 1.0, jacobians != nullptr, &image)) {
    return std::nullopt;
  }
  const Eigen::Array2d focal_px = tunable.focal_scale * focal_px_;
  if (jacobians != nullptr) {
    jacobians->pixel_by_point = focal_px.matrix().asDiagonal() * image.q_by_point;
    jacobians->pixel_by_intrinsics << (focal_px_ * image.q.array()).matrix(),
        Eigen::Matrix2d::Identity();
  }
  return (focal_px * image.q.array()).matrix() + tunable.principal_point_px;
}

std::optional<Eigen::Vector3d> EquidistantCamera::UnprojectTuned(
    const Eigen::Vector2d& pixel, const TunableIntrinsics& tunable,
    UnprojectionJacobians* jacobians) const {
  if (!(tunable.focal_scale > 0.0)) return std::nullopt;
  const Eigen::Array2d inverse_focal = 1.0 / (tunable.focal_scale * focal_px_);
  const Eigen::Vector2d q = ((pixel - tunable.principal_point_px).array() * inverse_focal).matrix();
  AngularProjection::Ray ray;
  if (!projection_.Unproject(q, 1.0, jacobians != nullptr, &ray)) return std::nullopt;
  if (jacobians != nullptr) {
    jacobians->ray_by_pixel = ray.ray_by_q * inverse_focal.matrix().asDiagonal();
    jacobians->ray_by_intrinsics << ray.ray_by_q * (-q / tunable.focal_scale),
        -jacobians->ray_by_pixel;
  }
  return ray.direction;
}

Result<CameraModelPtr> EquidistantCamera::WithTunable(const TunableIntrinsics& tunable) const {
  CameraIntrinsics folded = intrinsics_;
  folded.principal_point_px = tunable.principal_point_px;
  for (double& focal_px : folded.focal_px) focal_px *= tunable.focal_scale;
  return CreateCameraModel(folded);
}

}  // namespace scenecalib
