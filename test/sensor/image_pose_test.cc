#include "scenecalib/sensor/image_pose.h"

#include <gtest/gtest.h>

#include "scenecalib/geometry/so3.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

constexpr Timestamp kStampNs = 1700000000000000000;
constexpr double kLineTime_s = 5e-5;
constexpr int kWidth_px = 640;
constexpr int kHeight_px = 481;
constexpr double kFocal_px = 400.0;

CameraModelPtr Model() {
  return CreateCameraModel({"plumb_bob",
                            kWidth_px,
                            kHeight_px,
                            {kFocal_px, kFocal_px},
                            {320.0, 240.0},
                            {},
                            {0.0, 0.0, 0.0, 0.0, 0.0}})
      .value();
}

/// A vehicle that moves at 8 m/s along y and turns about z; the camera looks along x.
Trajectory Motion(double duration_s) {
  std::vector<TimedPose> poses;
  for (double t_s = 0.0; t_s <= duration_s; t_s += 1e-3) {
    poses.push_back(
        {AddSeconds(kStampNs, t_s), Rigid3(ExpSo3({0.0, 0.0, 0.2 * t_s}), {0.0, 8.0 * t_s, 0.0})});
  }
  return Trajectory::Create(poses).value();
}

CameraConfig Camera(std::optional<double> line_time_s) {
  CameraConfig camera;
  camera.model = Model();
  camera.rolling_shutter_line_time_s = line_time_s;
  Eigen::Matrix3d lidar_from_camera;
  lidar_from_camera << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  camera.lidar_from_camera = Rigid3(Eigen::Quaterniond(lidar_from_camera), {0.5, 0.1, 0.2});
  return camera;
}

double Distance(const Rigid3& a, const Rigid3& b) {
  return (a.translation - b.translation).norm() + RotationAngle(a.rotation, b.rotation);
}

TEST(ImagePose, OfAGlobalShutterIsOneForAllRows) {
  const Trajectory motion = Motion(0.1);
  CameraConfig camera = Camera(std::nullopt);
  camera.time_offset_s = 0.02;
  const auto pose = ImagePoseOf(camera, motion, kStampNs);
  ASSERT_TRUE(pose);
  EXPECT_FALSE(pose->is_rolling());
  const Rigid3 expected =
      *motion.Interpolate(AddSeconds(kStampNs, 0.02)) * camera.lidar_from_camera;
  EXPECT_EQ(Distance(pose->At(0.0), expected), 0.0);
  EXPECT_EQ(Distance(pose->At(480.0), expected), 0.0);
}

TEST(ImagePose, OfARollingShutterIsTheTrajectorysAtEachRowsTime) {
  const Trajectory motion = Motion(0.1);
  const CameraConfig camera = Camera(kLineTime_s);
  const auto pose = ImagePoseOf(camera, motion, kStampNs);
  ASSERT_TRUE(pose);
  EXPECT_TRUE(pose->is_rolling());
  for (const double row_px : {0.0, 100.0, 240.0, 333.0, 480.0}) {
    const Rigid3 expected =
        *motion.Interpolate(AddSeconds(kStampNs, kLineTime_s * row_px)) * camera.lidar_from_camera;
    EXPECT_LT(Distance(pose->At(row_px), expected), 1e-5) << row_px;
  }
  EXPECT_EQ(Distance(pose->At(-30.0), pose->At(0.0)), 0.0);
  EXPECT_EQ(Distance(pose->At(700.0), pose->At(480.0)), 0.0);
}

TEST(ImagePose, SeesAPointAtTheTimeOfItsOwnRow) {
  const Trajectory motion = Motion(0.1);
  // Upwards as well as downwards: some sensors are mounted upside down.
  for (const double line_time_s : {kLineTime_s, -kLineTime_s}) {
    const CameraConfig camera = Camera(line_time_s);
    const auto pose = ImagePoseOf(camera, motion, AddSeconds(kStampNs, 0.04));
    ASSERT_TRUE(pose);
    for (const double z_m : {-4.0, -1.0, 2.0, 4.5}) {
      const Eigen::Vector3d point(10.0, 1.0, z_m);
      const auto pixel = pose->Project(*camera.model, point);
      ASSERT_TRUE(pixel);
      const auto point_m = pose->WhenSeen(*camera.model, point);
      ASSERT_TRUE(point_m);
      EXPECT_LT((*camera.model->Project(*point_m) - *pixel).norm(), 1e-9);
      const auto then = camera.model->Project(pose->At(pixel->y()).Inverse() * point);
      ASSERT_TRUE(then);
      EXPECT_LT((*then - *pixel).norm(), 1e-3);
    }
    // 8 m/s over 240 rows of 50 us: 9.6 cm, of which 10 m away show 4 px.
    const auto low = pose->Project(*camera.model, {10.5, 1.0, -5.6});
    const auto middle = pose->Project(*camera.model, {10.5, 1.0, 0.2});
    ASSERT_TRUE(low && middle);
    const double sign = line_time_s > 0.0 ? 1.0 : -1.0;
    EXPECT_NEAR(low->x() - middle->x(), sign * 4.0, 1.2);
  }
}

TEST(ImagePose, IsNoneWhereReadingOutLeavesTheTrajectory) {
  const Trajectory motion = Motion(0.1);
  const Timestamp near_end_ns = AddSeconds(kStampNs, 0.09);
  EXPECT_TRUE(ImagePoseOf(Camera(std::nullopt), motion, near_end_ns));
  EXPECT_FALSE(ImagePoseOf(Camera(kLineTime_s), motion, near_end_ns));
  EXPECT_FALSE(ImagePoseOf(Camera(-kLineTime_s), motion, kStampNs));
}

TEST(ImagePose, SeesNothingOutsideTheLens) {
  const ImagePose pose(Rigid3(), Rigid3(), Rigid3({1, 0, 0, 0}, {0.01, 0.0, 0.0}), kHeight_px);
  EXPECT_FALSE(pose.WhenSeen(*Model(), {0.0, 0.0, -5.0}));
  EXPECT_FALSE(pose.Project(*Model(), {0.0, 0.0, -5.0}));
  EXPECT_FALSE(pose.Project(*Model(), {20.0, 0.0, 5.0}));
}

}  // namespace
}  // namespace scenecalib
