#include "scenecalib/calibration/transfer_error.h"

#include <cmath>
#include <optional>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kMinRange_m = 0.05;  // closer than this the ray does not meet the plane
constexpr double kMinCosine = 0.01;   // flatter than 89.4 degrees the point is undefined

/// A view's pose with its correction, and what the derivatives reuse.
struct PosedView {
  Eigen::Matrix3d rotation_lidar_from_camera;
  Eigen::Vector3d camera_in_lidar;
  Eigen::Matrix3d correction;  // Exp(c_r)
  Vector6d c;
  Eigen::Matrix3d map_from_lidar;   // uncorrected rotation
  Eigen::Matrix3d map_from_camera;  // corrected rotation
  Eigen::Vector3d camera_in_map;
};

PosedView Pose(const TransferView& view, const CameraParameters& camera,
               const Vector6d& correction) {
  PosedView posed;
  posed.c = correction + view.twist_in_lidar * camera.time_offset_delta_s;
  const Rigid3 lidar_from_camera = camera.LidarFromCamera();
  posed.rotation_lidar_from_camera = lidar_from_camera.RotationMatrix();
  posed.camera_in_lidar = lidar_from_camera.translation;
  posed.correction = ExpSo3(posed.c.head<3>()).toRotationMatrix();
  posed.map_from_lidar = view.map_from_lidar.RotationMatrix();
  posed.map_from_camera =
      posed.map_from_lidar * posed.correction * posed.rotation_lidar_from_camera;
  posed.camera_in_map =
      posed.map_from_lidar * (posed.correction * posed.camera_in_lidar + posed.c.tail<3>()) +
      view.map_from_lidar.translation;
  return posed;
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

bool EvaluateTransfer(const TransferView& source, const CameraParameters& source_camera,
                      const Vector6d& source_correction, const TransferView& target,
                      const CameraParameters& target_camera, const Vector6d& target_correction,
                      const Eigen::Vector3d& plane_point_in_map_m,
                      const Eigen::Vector3d& plane_normal_in_map, Eigen::Vector2d* residual_px,
                      TransferJacobians* jacobians) {
  UnprojectionJacobians ray_jacobians;
  const std::optional<Eigen::Vector3d> ray = source_camera.model->UnprojectTuned(
      source.pixel, source_camera.Intrinsics(), jacobians ? &ray_jacobians : nullptr);
  if (!ray) return false;
  const PosedView a = Pose(source, source_camera, source_correction);
  const PosedView b = Pose(target, target_camera, target_correction);

  // Eq. (1): x = Gamma(...).
  const Eigen::Vector3d& n = plane_normal_in_map;
  const Eigen::Vector3d direction = a.map_from_camera * *ray;
  const double cosine = n.dot(direction);
  if (std::abs(cosine) < kMinCosine) return false;
  const double range = n.dot(plane_point_in_map_m - a.camera_in_map) / cosine;
  if (!(range > kMinRange_m)) return false;
  const Eigen::Vector3d x = a.camera_in_map + range * direction;

  // Eq. (2): into the target view.
  const Eigen::Vector3d w =
      b.map_from_lidar.transpose() * (x - target.map_from_lidar.translation) - b.c.tail<3>();
  const Eigen::Vector3d x_in_lidar = b.correction.transpose() * w;
  const Eigen::Vector3d y =
      b.rotation_lidar_from_camera.transpose() * (x_in_lidar - b.camera_in_lidar);
  ProjectionJacobians projection;
  const std::optional<Eigen::Vector2d> pixel = target_camera.model->ProjectTuned(
      y, target_camera.Intrinsics(), jacobians ? &projection : nullptr);
  if (!pixel) return false;
  *residual_px = *pixel - target.pixel;
  if (jacobians == nullptr) return true;

  const Eigen::Matrix<double, 2, 3>& pixel_by_y = projection.pixel_by_point;
  const Eigen::Matrix<double, 2, 3> pixel_by_x = pixel_by_y * b.map_from_camera.transpose();
  // dx = P (d origin + range d direction), P = I - direction n^T / (n . direction).
  const Eigen::Matrix<double, 2, 3> pixel_by_free_x =
      pixel_by_x - (pixel_by_x * direction) * n.transpose() / cosine;
  const Eigen::Matrix3d source_left = LeftJacobianSo3(source_camera.rotation_delta_rad);
  const Eigen::Vector3d ray_in_lidar = a.rotation_lidar_from_camera * *ray;
  const Eigen::Vector3d x_in_source_lidar =
      a.correction * (a.camera_in_lidar + range * ray_in_lidar);
  const Eigen::Matrix3d map_from_corrected = a.map_from_lidar * a.correction;

  TransferViewJacobians& s = jacobians->source;
  s.by_translation = pixel_by_free_x * map_from_corrected;
  s.by_rotation = -range * s.by_translation * Hat(ray_in_lidar) * source_left;
  s.by_intrinsics = range * (pixel_by_free_x * a.map_from_camera) * ray_jacobians.ray_by_intrinsics;
  const Eigen::Matrix<double, 2, 3> by_lidar_point = pixel_by_free_x * a.map_from_lidar;
  s.by_correction.leftCols<3>() =
      -by_lidar_point * Hat(x_in_source_lidar) * LeftJacobianSo3(a.c.head<3>());
  s.by_correction.rightCols<3>() = by_lidar_point;

  TransferViewJacobians& t = jacobians->target;
  const Eigen::Matrix<double, 2, 3> pixel_by_lidar_point =
      pixel_by_y * b.rotation_lidar_from_camera.transpose();
  t.by_translation = -pixel_by_lidar_point;
  t.by_rotation = pixel_by_lidar_point * Hat(x_in_lidar - b.camera_in_lidar) *
                  LeftJacobianSo3(target_camera.rotation_delta_rad);
  t.by_intrinsics = projection.pixel_by_intrinsics;
  const Eigen::Matrix<double, 2, 3> pixel_by_w = pixel_by_lidar_point * b.correction.transpose();
  t.by_correction.leftCols<3>() = pixel_by_w * Hat(w) * LeftJacobianSo3(b.c.head<3>());
  t.by_correction.rightCols<3>() = -pixel_by_w;

  jacobians->by_source_pixel =
      range * (pixel_by_free_x * a.map_from_camera) * ray_jacobians.ray_by_pixel;
  jacobians->by_plane_offset = pixel_by_x * direction / cosine;
  return true;
}

}  // namespace scenecalib
