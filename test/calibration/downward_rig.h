#pragma once

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <vector>

#include "scenecalib/calibration/calibration_problem.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib::testing {

/// Cameras without distortion that look straight down on the ground z = 0; the lidar's axes are the
/// map's. A pixel is 1 / 400 of the height above the ground.
class DownwardRig : public ::testing::Test {
 protected:
  static constexpr double kFocalPx = 400.0;

  explicit DownwardRig(int num_cameras = 1) {
    CameraIntrinsics intrinsics;
    intrinsics.model = "plumb_bob";
    intrinsics.width_px = 1000;
    intrinsics.height_px = 1000;
    intrinsics.focal_px = {kFocalPx, kFocalPx};
    intrinsics.principal_point_px = {500.0, 500.0};
    intrinsics.distortion = {0.0, 0.0, 0.0, 0.0, 0.0};
    model_ = CreateCameraModel(intrinsics).value();
    Eigen::Matrix3d down;
    down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
    for (int c = 0; c < num_cameras; ++c) {
      CameraParameters camera;
      camera.model = model_.get();
      camera.intrinsics << 1.0, 500.0, 500.0;
      camera.base_lidar_from_camera = Rigid3(Eigen::Quaterniond(down), {0.2 * c, 0.0, 0.0});
      cameras_.push_back(camera);
    }
  }

  /// Where a camera with these parameters sees a point; the lidar is at `lidar_in_map_m`.
  Eigen::Vector2d See(const CameraParameters& camera, const Eigen::Vector3d& lidar_in_map_m,
                      const Eigen::Vector3d& point_in_map_m) const {
    const Eigen::Vector3d point_in_lidar_m = point_in_map_m - lidar_in_map_m;
    return model_->Project(camera.LidarFromCamera().Inverse() * point_in_lidar_m).value();
  }

  CameraModelPtr model_;
  std::vector<CameraParameters> cameras_;
};

}  // namespace scenecalib::testing
