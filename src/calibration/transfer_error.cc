#include "scenecalib/calibration/transfer_error.h"

#include <cmath>
#include <optional>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kMinRange_m = 0.05;  // closer than this the ray does not meet the plane
constexpr double kMinCosine = 0.01;   // flatter than 89.4 degrees the point is undefined

TransferViewJacobians ByParameters(const Eigen::Matrix<double, 2, 9>& by_pose,
                                   const ViewMotion& motion) {
  const Eigen::Matrix<double, 2, 12> by_parameters = by_pose.leftCols<6>() * motion;
  TransferViewJacobians result;
  result.by_rotation = by_parameters.leftCols<3>();
  result.by_translation = by_parameters.middleCols<3>(3);
  result.by_correction = by_parameters.rightCols<6>();
  result.by_intrinsics = by_pose.rightCols<3>();
  return result;
}

}  // namespace

Rigid3 CameraParameters::LidarFromCamera() const {
  return {ExpSo3(rotation_delta_rad) * base_lidar_from_camera.rotation,
          base_lidar_from_camera.translation + translation_delta_m};
}

void CameraParameters::Rebase() {
  base_lidar_from_camera = LidarFromCamera();
  rotation_delta_rad.setZero();
  translation_delta_m.setZero();
}

ViewPose PoseOf(const TransferView& view, const CameraParameters& camera,
                const Vector6d& correction) {
  const Vector6d c = correction + view.twist_in_lidar * camera.time_offset_delta_s;
  const Rigid3 lidar_from_camera = camera.LidarFromCamera();
  const Eigen::Matrix3d map_from_lidar = view.map_from_lidar.RotationMatrix();
  const Eigen::Matrix3d turned = ExpSo3(c.head<3>()).toRotationMatrix();
  ViewPose pose;
  pose.map_from_camera = map_from_lidar * turned * lidar_from_camera.RotationMatrix();
  pose.camera_in_map_m = map_from_lidar * (turned * lidar_from_camera.translation + c.tail<3>()) +
                         view.map_from_lidar.translation;
  return pose;
}

ViewMotion MotionOf(const TransferView& view, const CameraParameters& camera,
                    const Vector6d& correction) {
  const Vector6d c = correction + view.twist_in_lidar * camera.time_offset_delta_s;
  const Eigen::Matrix3d map_from_lidar = view.map_from_lidar.RotationMatrix();
  const Eigen::Matrix3d turned = ExpSo3(c.head<3>()).toRotationMatrix();
  const Eigen::Matrix3d correction_left = LeftJacobianSo3(c.head<3>());
  const Eigen::Vector3d camera_in_lidar = turned * camera.LidarFromCamera().translation;
  ViewMotion motion = ViewMotion::Zero();
  motion.block<3, 3>(0, 0) = map_from_lidar * turned * LeftJacobianSo3(camera.rotation_delta_rad);
  motion.block<3, 3>(3, 3) = map_from_lidar * turned;
  motion.block<3, 3>(0, 6) = map_from_lidar * correction_left;
  motion.block<3, 3>(3, 6) = -map_from_lidar * Hat(camera_in_lidar) * correction_left;
  motion.block<3, 3>(3, 9) = map_from_lidar;
  return motion;
}

SourceRay RayOf(const CameraParameters& camera, const Eigen::Vector2d& pixel,
                bool with_derivatives) {
  SourceRay ray;
  ray.direction = camera.model->UnprojectTuned(pixel, camera.Intrinsics(),
                                               with_derivatives ? &ray.jacobians : nullptr);
  return ray;
}

bool EvaluatePosedTransfer(const SourceRay& ray, const ViewPose& source,
                           const Eigen::Vector2d& target_pixel,
                           const CameraParameters& target_camera, const ViewPose& target,
                           const Eigen::Vector3d& plane_point_in_map_m,
                           const Eigen::Vector3d& plane_normal_in_map, Eigen::Vector2d* residual_px,
                           PoseJacobians* jacobians) {
  if (!ray.direction) return false;

  // Eq. (1): x = Gamma(...).
  const Eigen::Vector3d& n = plane_normal_in_map;
  const Eigen::Vector3d direction = source.map_from_camera * *ray.direction;
  const double cosine = n.dot(direction);
  if (std::abs(cosine) < kMinCosine) return false;
  const double range = n.dot(plane_point_in_map_m - source.camera_in_map_m) / cosine;
  if (!(range > kMinRange_m)) return false;
  const Eigen::Vector3d x = source.camera_in_map_m + range * direction;

  // Eq. (2): into the target view.
  const Eigen::Vector3d from_target = x - target.camera_in_map_m;
  ProjectionJacobians projection;
  const std::optional<Eigen::Vector2d> pixel = target_camera.model->ProjectTuned(
      target.map_from_camera.transpose() * from_target, target_camera.Intrinsics(),
      jacobians ? &projection : nullptr);
  if (!pixel) return false;
  *residual_px = *pixel - target_pixel;
  if (jacobians == nullptr) return true;

  const Eigen::Matrix<double, 2, 3> pixel_by_x =
      projection.pixel_by_point * target.map_from_camera.transpose();
  // dx = P (d origin + range d direction), P = I - direction n^T / (n . direction).
  const Eigen::Vector2d along_ray = pixel_by_x * direction / cosine;
  const Eigen::Matrix<double, 2, 3> pixel_by_free_x = pixel_by_x - along_ray * n.transpose();
  const Eigen::Matrix<double, 2, 3> pixel_by_ray =
      range * (pixel_by_free_x * source.map_from_camera);
  jacobians->source.leftCols<3>() = -range * (pixel_by_free_x * Hat(direction));
  jacobians->source.middleCols<3>(3) = pixel_by_free_x;
  jacobians->source.rightCols<3>() = pixel_by_ray * ray.jacobians.ray_by_intrinsics;
  jacobians->target.leftCols<3>() = pixel_by_x * Hat(from_target);
  jacobians->target.middleCols<3>(3) = -pixel_by_x;
  jacobians->target.rightCols<3>() = projection.pixel_by_intrinsics;
  jacobians->by_source_pixel = pixel_by_ray * ray.jacobians.ray_by_pixel;
  jacobians->by_plane_offset = along_ray;
  return true;
}

bool EvaluateTransfer(const TransferView& source, const CameraParameters& source_camera,
                      const Vector6d& source_correction, const TransferView& target,
                      const CameraParameters& target_camera, const Vector6d& target_correction,
                      const Eigen::Vector3d& plane_point_in_map_m,
                      const Eigen::Vector3d& plane_normal_in_map, Eigen::Vector2d* residual_px,
                      TransferJacobians* jacobians) {
  PoseJacobians by_pose;
  if (!EvaluatePosedTransfer(RayOf(source_camera, source.pixel, jacobians != nullptr),
                             PoseOf(source, source_camera, source_correction), target.pixel,
                             target_camera, PoseOf(target, target_camera, target_correction),
                             plane_point_in_map_m, plane_normal_in_map, residual_px,
                             jacobians ? &by_pose : nullptr)) {
    return false;
  }
  if (jacobians == nullptr) return true;
  jacobians->source =
      ByParameters(by_pose.source, MotionOf(source, source_camera, source_correction));
  jacobians->target =
      ByParameters(by_pose.target, MotionOf(target, target_camera, target_correction));
  jacobians->by_source_pixel = by_pose.by_source_pixel;
  jacobians->by_plane_offset = by_pose.by_plane_offset;
  return true;
}

}  // namespace scenecalib
