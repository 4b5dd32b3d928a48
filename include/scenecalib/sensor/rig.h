#pragma once

#include <optional>
#include <string>
#include <vector>

#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/sensor/camera_model.h"

namespace scenecalib {

/// The sensors of a vehicle, as in the rig file (docs/ros_api.md).
struct LidarConfig {
  std::string topic;
  std::string frame_id;
  bool motion_compensated = false;      ///< true: every point is already at the scan's stamp
  std::optional<double> scan_period_s;  ///< only for clouds without per-point time
};

struct ImuConfig {
  std::string topic;
  Rigid3 lidar_from_imu;
};

struct OdometryConfig {
  std::string topic;
  Rigid3 lidar_from_body;
};

/// How far off a camera's initial values may be, one standard deviation each, where the rig file
/// says so. Pose in the camera frame's axes (right, down, forward).
struct InitialStddev {
  std::optional<Eigen::Vector3d> translation_m;
  std::optional<Eigen::Vector3d> rotation_rad;  ///< about these axes: pitch, yaw, roll
  std::optional<double> focal_scale;            ///< of s_f, a share of the focal length
  std::optional<Eigen::Vector2d> principal_point_px;
  std::optional<double> time_offset_s;
};

struct CameraConfig {
  std::string name;
  std::string image_topic;
  std::optional<std::string> camera_info_topic;
  std::string frame_id;
  double time_offset_s = 0.0;  ///< camera stamp + offset = lidar clock
  Rigid3 lidar_from_camera;
  InitialStddev initial_stddev;
  /// Pixels that never see the scene are black (0) in this 8-bit image of the camera's size,
  /// anything else is seen: the own vehicle, a lens's dirt. Relative to the rig file's directory.
  std::optional<std::string> mask_file;
  /// Rows are exposed one after the other, the top one at the image's stamp; none: all at once.
  std::optional<double> rolling_shutter_line_time_s;
  CameraModelPtr model;  ///< null until the camera_info message gave the intrinsics
};

struct Rig {
  LidarConfig lidar;
  std::optional<ImuConfig> imu;
  std::optional<OdometryConfig> odometry;
  std::vector<CameraConfig> cameras;  ///< in the order of the file
  /// Result file of another recording of the same vehicle, whose values a camera keeps that cannot
  /// be calibrated. Relative to the rig file's directory.
  std::optional<std::string> fallback_file;
};

}  // namespace scenecalib
