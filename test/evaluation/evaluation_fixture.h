#pragma once

#include <gtest/gtest.h>

#include "scenecalib/geometry/so3.h"
#include "scenecalib/sensor/camera_factory.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// 640x480, f = 500 px, no distortion, looking along the lidar's x axis from its origin.
inline CameraConfig ForwardCamera(const std::string& name) {
  CameraConfig camera;
  camera.name = name;
  Eigen::Matrix3d lidar_from_camera;
  lidar_from_camera << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  camera.lidar_from_camera.rotation = Eigen::Quaterniond(lidar_from_camera);
  const auto model = CreateCameraModel(
      {"plumb_bob", 640, 480, {500.0, 500.0}, {319.5, 239.5}, {}, {0.0, 0.0, 0.0, 0.0, 0.0}});
  EXPECT_TRUE(model.ok());
  camera.model = *model;
  return camera;
}

/// The camera after a motion in its own frame.
inline CameraConfig Moved(CameraConfig camera, const Eigen::Vector3d& rotation_rad,
                          const Eigen::Vector3d& translation_m) {
  camera.lidar_from_camera = camera.lidar_from_camera * Rigid3(ExpSo3(rotation_rad), translation_m);
  return camera;
}

inline Rig RigOf(const std::vector<CameraConfig>& cameras) {
  Rig rig;
  rig.cameras = cameras;
  return rig;
}

}  // namespace scenecalib
