#include <Eigen/Geometry>
#include <cmath>

#include "scenecalib/sensor/camera_factory.h"
#include "scenecalib/simulation/simulator.h"

namespace scenecalib {

namespace {

/// Rotation body_from_camera of a camera that looks along yaw (to the left) and pitch (downwards).
Eigen::Quaterniond LookAlong(double yaw_deg, double pitch_deg, double roll_deg) {
  Eigen::Matrix3d body_from_forward_camera;  // columns: the camera's right, down, forward
  body_from_forward_camera << 0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0;
  const double degree = M_PI / 180.0;
  return Eigen::AngleAxisd(yaw_deg * degree, Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(pitch_deg * degree, Eigen::Vector3d::UnitY()) *
         Eigen::AngleAxisd(roll_deg * degree, Eigen::Vector3d::UnitX()) *
         Eigen::Quaterniond(body_from_forward_camera);
}

struct CameraPlan {
  std::string name;
  Rigid3 body_from_camera;
  CameraIntrinsics intrinsics;
};

std::vector<CameraPlan> PlanCameras() {
  CameraPlan front;
  front.name = "front";
  front.body_from_camera = {LookAlong(0.6, 2.2, -0.4), {1.55, 0.05, 1.52}};
  front.intrinsics.model = "plumb_bob";
  front.intrinsics.width_px = 960;
  front.intrinsics.height_px = 600;
  front.intrinsics.focal_px = {685.0, 686.0};
  front.intrinsics.principal_point_px = {482.0, 297.0};
  front.intrinsics.distortion = {-0.065, 0.022, 0.0004, -0.0003, 0.0};

  CameraPlan left;
  left.name = "left";
  left.body_from_camera = {LookAlong(62.0, 6.0, 1.0), {1.75, 1.0, 1.1}};
  left.intrinsics.model = "ftheta";
  left.intrinsics.width_px = 960;
  left.intrinsics.height_px = 600;
  left.intrinsics.principal_point_px = {477.0, 302.0};
  left.intrinsics.polynomial_px = {460.0, -1.5, -6.0, 1.1, 0.3};

  CameraPlan fisheye;
  fisheye.name = "fisheye";
  fisheye.body_from_camera = {LookAlong(-1.5, 11.0, 0.7), {3.72, -0.03, 0.75}};
  fisheye.intrinsics.model = "ftheta";
  fisheye.intrinsics.width_px = 1280;
  fisheye.intrinsics.height_px = 720;
  fisheye.intrinsics.principal_point_px = {643.0, 356.0};
  fisheye.intrinsics.polynomial_px = {380.0, 2.5, -8.5, 1.1, 0.0};
  return {front, left, fisheye};
}

}  // namespace

Result<Rig> DefaultRig() {
  Rig rig;
  rig.lidar.topic = "/lidar/points";
  rig.lidar.frame_id = "lidar";
  const double degree = M_PI / 180.0;
  // The body frame: on the ground below the rear axle; the lidar is mounted a little askew.
  const Rigid3 body_from_lidar(
      Eigen::Quaterniond(Eigen::AngleAxisd(0.7 * degree, Eigen::Vector3d::UnitZ()) *
                         Eigen::AngleAxisd(-0.5 * degree, Eigen::Vector3d::UnitY()) *
                         Eigen::AngleAxisd(0.4 * degree, Eigen::Vector3d::UnitX())),
      {1.0, 0.01, 1.9});
  const Rigid3 lidar_from_body = body_from_lidar.Inverse();
  const Rigid3 body_from_imu(Eigen::Quaterniond(Eigen::AngleAxisd(
                                 1.2 * degree, Eigen::Vector3d(0.3, -0.5, 0.8).normalized())),
                             {0.35, 0.12, 0.48});
  rig.imu = ImuConfig{"/imu/data", lidar_from_body * body_from_imu};
  rig.odometry = OdometryConfig{"/odometry", lidar_from_body};
  for (const CameraPlan& plan : PlanCameras()) {
    CameraConfig camera;
    camera.name = plan.name;
    camera.image_topic = "/" + plan.name + "/image_raw/compressed";
    camera.frame_id = plan.name + "_optical";
    camera.lidar_from_camera = lidar_from_body * plan.body_from_camera;
    Result<CameraModelPtr> model = CreateCameraModel(plan.intrinsics);
    if (!model.ok()) return model.status();
    camera.model = *model;
    rig.cameras.push_back(camera);
  }
  return rig;
}

}  // namespace scenecalib
