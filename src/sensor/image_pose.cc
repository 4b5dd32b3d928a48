#include "scenecalib/sensor/image_pose.h"

#include <algorithm>
#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

/// A row's motion in the image while it is searched for shrinks by line time times image speed, a
/// few percent, with every step.
constexpr int kMaxSteps = 8;
constexpr double kConverged_px = 1e-3;

}  // namespace

ImagePose::ImagePose(const Rigid3& first_map_from_camera, const Rigid3& middle_map_from_camera,
                     const Rigid3& last_map_from_camera, int height_px)
    : ImagePose(middle_map_from_camera) {
  half_height_px_ = std::max(0.5, 0.5 * (height_px - 1));
  const Eigen::Quaterniond camera_from_map = middle_map_from_camera.rotation.conjugate();
  turn_rad_ =
      0.5 * LogSo3(first_map_from_camera.rotation.conjugate() * last_map_from_camera.rotation);
  shift_m_ = 0.5 * (camera_from_map *
                    (last_map_from_camera.translation - first_map_from_camera.translation));
}

Rigid3 ImagePose::At(double row_px) const {
  if (!is_rolling()) return map_from_camera_;
  const double share = std::clamp(row_px / half_height_px_ - 1.0, -1.0, 1.0);
  return map_from_camera_ * Rigid3(ExpSo3(share * turn_rad_), share * shift_m_);
}

std::optional<Eigen::Vector3d> ImagePose::WhenSeen(const CameraModel& camera,
                                                   const Eigen::Vector3d& point_in_map_m) const {
  if (!is_rolling()) return camera_from_map_ * point_in_map_m;
  double row_px = half_height_px_;
  for (int step = 0; step < kMaxSteps; ++step) {
    const Eigen::Vector3d point_m = At(row_px).Inverse() * point_in_map_m;
    const auto pixel = camera.ProjectTuned(point_m, camera.tunable(), nullptr);
    if (!pixel) return std::nullopt;
    const double moved_px = std::abs(pixel->y() - row_px);
    row_px = pixel->y();
    if (moved_px < kConverged_px) return point_m;
  }
  return At(row_px).Inverse() * point_in_map_m;
}

std::optional<Eigen::Vector2d> ImagePose::Project(const CameraModel& camera,
                                                  const Eigen::Vector3d& point_in_map_m) const {
  const auto point_m = WhenSeen(camera, point_in_map_m);
  return point_m ? camera.Project(*point_m) : std::nullopt;
}

std::optional<ImagePose> ImagePoseOf(const CameraConfig& camera, const Trajectory& map_from_lidar,
                                     Timestamp stamp_ns) {
  const double line_time_s = camera.model ? camera.rolling_shutter_line_time_s.value_or(0.0) : 0.0;
  return ImagePoseAt(AddSeconds(stamp_ns, camera.time_offset_s), line_time_s,
                     camera.model ? camera.model->height_px() : 0, camera.lidar_from_camera,
                     [&](Timestamp at_ns) { return map_from_lidar.Interpolate(at_ns); });
}

}  // namespace scenecalib
