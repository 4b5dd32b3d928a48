#pragma once

#include <Eigen/Core>
#include <optional>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/geometry/trajectory.h"
#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// Where a camera is while it takes an image. A global shutter has one pose; under a rolling one
/// the camera moves on from row to row, with a constant twist over the image (at 3 m/s^2 and 30 ms
/// of reading out that is 0.3 mm off in the outermost rows).
class ImagePose {
 public:
  ImagePose() = default;
  /// A global shutter. Implicit: wherever a pose is all there is, it is that of every row.
  ImagePose(const Rigid3& map_from_camera)
      : map_from_camera_(map_from_camera), camera_from_map_(map_from_camera.Inverse()) {}
  /// A rolling shutter, by the poses at the first row (0), the middle one and the last one.
  ImagePose(const Rigid3& first_map_from_camera, const Rigid3& middle_map_from_camera,
            const Rigid3& last_map_from_camera, int height_px);

  /// At the middle row.
  const Rigid3& map_from_camera() const { return map_from_camera_; }
  bool is_rolling() const { return half_height_px_ > 0.0; }

  /// map_from_camera when a row is exposed; beyond the image that of its border.
  Rigid3 At(double row_px) const;

  /// A point in the camera's frame at the time when its own row is exposed; none when the lens does
  /// not see it. With a global shutter always there: nobody has asked the lens yet.
  std::optional<Eigen::Vector3d> WhenSeen(const CameraModel& camera,
                                          const Eigen::Vector3d& point_in_map_m) const;

  /// Pixel at which a point of the map is seen; none outside the image or the lens.
  std::optional<Eigen::Vector2d> Project(const CameraModel& camera,
                                         const Eigen::Vector3d& point_in_map_m) const;

 private:
  Rigid3 map_from_camera_;
  Rigid3 camera_from_map_;
  double half_height_px_ = 0.0;  ///< between the first row and the middle one; 0: global shutter
  Eigen::Vector3d turn_rad_ = Eigen::Vector3d::Zero();  ///< over that, in the camera's frame
  Eigen::Vector3d shift_m_ = Eigen::Vector3d::Zero();
};

/// The pose of the camera's image with this stamp (the camera's own clock, the first row's), by its
/// time offset, its line time and its place on the vehicle. None unless the trajectory covers the
/// whole image.
std::optional<ImagePose> ImagePoseOf(const CameraConfig& camera, const Trajectory& map_from_lidar,
                                     Timestamp stamp_ns);

/// The same for anything that tells the lidar's pose at a time: `map_from_lidar_at(Timestamp)`
/// gives a std::optional<Rigid3>. `first_row_ns` is on the lidar's clock.
template <typename MapFromLidarAt>
std::optional<ImagePose> ImagePoseAt(Timestamp first_row_ns, double line_time_s, int height_px,
                                     const Rigid3& lidar_from_camera,
                                     const MapFromLidarAt& map_from_lidar_at) {
  const std::optional<Rigid3> first = map_from_lidar_at(first_row_ns);
  if (!first) return std::nullopt;
  if (line_time_s == 0.0) return ImagePose(*first * lidar_from_camera);
  const double half_s = 0.5 * line_time_s * (height_px - 1);
  const std::optional<Rigid3> middle = map_from_lidar_at(AddSeconds(first_row_ns, half_s));
  const std::optional<Rigid3> last = map_from_lidar_at(AddSeconds(first_row_ns, 2.0 * half_s));
  if (!middle || !last) return std::nullopt;
  return ImagePose(*first * lidar_from_camera, *middle * lidar_from_camera,
                   *last * lidar_from_camera, height_px);
}

}  // namespace scenecalib
