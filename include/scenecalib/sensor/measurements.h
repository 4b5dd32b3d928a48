#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/geometry/rigid3.h"

namespace scenecalib {

/// One lidar return.
struct LidarPoint {
  Eigen::Vector3f position_in_lidar_m = Eigen::Vector3f::Zero();  ///< at the point's own time
  float time_offset_s = 0.0F;  ///< point time minus LidarScan::stamp_ns; may be negative
  float intensity = 0.0F;      ///< unit of the sensor, 0 when it gives none
  std::uint16_t ring = 0;      ///< laser index, 0 when the sensor gives none
};

/// One sweep. Every point is finite and beyond the origin; each is expressed in the lidar frame at
/// its own time, or all at stamp_ns (then every time_offset_s is 0) if the driver compensated
/// motion.
struct LidarScan {
  Timestamp stamp_ns = 0;  ///< message stamp, lidar clock
  std::vector<LidarPoint> points;
};

/// Angular rate and specific force in the IMU frame (x, y, z), lidar clock.
struct ImuSample {
  Timestamp stamp_ns = 0;
  Eigen::Vector3d angular_velocity_rad_s = Eigen::Vector3d::Zero();
  Eigen::Vector3d linear_acceleration_m_s2 = Eigen::Vector3d::Zero();  ///< +g upwards at rest
};

/// Pose of the odometry's body frame in its own, drifting, odometry frame; lidar clock.
struct OdometrySample {
  Timestamp stamp_ns = 0;
  Rigid3 odom_from_body;
};

/// One image, converted to 8-bit grey (CV_8UC1). The stamp is the camera's own clock: add the
/// camera's time_offset_s to get lidar clock.
struct GrayImage {
  Timestamp stamp_ns = 0;
  cv::Mat pixels;
  /// The same image in colour (CV_8UC3, BGR), now and then, for pictures; mostly empty.
  cv::Mat colour = {};
};

}  // namespace scenecalib
