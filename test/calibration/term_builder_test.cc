#include "scenecalib/calibration/term_builder.h"

#include <gtest/gtest.h>

namespace scenecalib {
namespace {

constexpr Timestamp kStart = 1'000'000'000;
constexpr double kSpeedMPerS = 10.0;

Trajectory StraightDrive() {
  std::vector<TimedPose> poses;
  for (int i = 0; i <= 10; ++i) {
    poses.push_back({AddSeconds(kStart, 0.1 * i),
                     Rigid3(Eigen::Quaterniond::Identity(), {kSpeedMPerS * 0.1 * i, 0.0, 0.0})});
  }
  return Trajectory::Create(poses).value();
}

TrackObservation InRow(double row) {
  TrackObservation observation;
  observation.stamp_ns = AddSeconds(kStart, 0.3);
  observation.pixel = {100.0, row};
  return observation;
}

class RollingShutterTest : public ::testing::Test {
 protected:
  RollingShutterTest() {
    context_.parameters = &parameters_;
    context_.map_from_lidar = &trajectory_;
    context_.time_offset_s = 0.05;
  }

  const Trajectory trajectory_ = StraightDrive();
  CameraParameters parameters_;
  CameraContext context_;
};

TEST_F(RollingShutterTest, AGlobalShutterSeesAllRowsAtOnce) {
  EXPECT_EQ(StampOf(context_, InRow(0.0)), AddSeconds(kStart, 0.35));
  EXPECT_EQ(StampOf(context_, InRow(599.0)), StampOf(context_, InRow(0.0)));
}

TEST_F(RollingShutterTest, EveryRowHasItsOwnTimeAndPose) {
  parameters_.rolling_shutter_line_time_s = 5e-5;
  EXPECT_EQ(StampOf(context_, InRow(0.0)), AddSeconds(kStart, 0.35));
  EXPECT_EQ(StampOf(context_, InRow(400.0)), AddSeconds(kStart, 0.37));
  const auto top = ViewAt(context_, InRow(0.0));
  const auto below = ViewAt(context_, InRow(400.0));
  ASSERT_TRUE(top && below);
  EXPECT_NEAR(below->map_from_lidar.translation.x() - top->map_from_lidar.translation.x(),
              kSpeedMPerS * 0.02, 1e-6);
}

TEST_F(RollingShutterTest, RowsReadUpwardsHaveANegativeLineTime) {
  parameters_.rolling_shutter_line_time_s = -5e-5;
  EXPECT_EQ(StampOf(context_, InRow(400.0)), AddSeconds(kStart, 0.33));
}

TEST_F(RollingShutterTest, ARowOutsideTheTrajectoryIsNoView) {
  parameters_.rolling_shutter_line_time_s = 1e-3;
  EXPECT_TRUE(ViewAt(context_, InRow(0.0)));
  EXPECT_FALSE(ViewAt(context_, InRow(900.0)));
}

}  // namespace
}  // namespace scenecalib
