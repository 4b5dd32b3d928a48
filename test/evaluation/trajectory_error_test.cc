#include "scenecalib/evaluation/trajectory_error.h"

#include <gtest/gtest.h>

#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr Timestamp kStartNs = 1700000000000000000;

/// Straight along x at 10 m/s, times `scale`, turning by `rate_rad_s` about z on the spot.
Trajectory Drive(double duration_s, double scale, double rate_rad_s) {
  std::vector<TimedPose> poses;
  for (int i = 0; i <= duration_s * 100.0; ++i) {
    const double t = 0.01 * i;
    poses.push_back({AddSeconds(kStartNs, t),
                     Rigid3(ExpSo3({0.0, 0.0, rate_rad_s * t}), {10.0 * scale * t, 0.0, 0.0})});
  }
  return Trajectory::Create(std::move(poses)).value();
}

TEST(TrajectoryError, IsZeroForTheTruthInAnyFrame) {
  const Trajectory truth = Drive(5.0, 1.0, 0.1);
  const Rigid3 other_from_map(ExpSo3({0.3, -0.2, 1.0}), {5.0, -7.0, 2.0});
  std::vector<TimedPose> poses = truth.poses();
  for (TimedPose& pose : poses) pose.map_from_lidar = other_from_map * pose.map_from_lidar;
  const auto errors =
      CompareRelativeMotion(truth, Trajectory::Create(poses).value(), {0.5, 4.0}).value();
  for (const RelativeMotionError& error : errors) {
    EXPECT_NEAR(error.translation_m, 0.0, 1e-9);
    EXPECT_NEAR(error.rotation_rad, 0.0, 1e-9);
  }
}

TEST(TrajectoryError, ScaleAndTurnGrowWithTheWindow) {
  const Trajectory truth = Drive(5.0, 1.0, 0.0);
  const auto scaled = CompareRelativeMotion(truth, Drive(5.0, 1.001, 0.0), {0.5, 2.0}).value();
  EXPECT_NEAR(scaled[0].translation_m, 0.005, 1e-6);
  EXPECT_NEAR(scaled[1].translation_m, 0.02, 1e-6);
  EXPECT_NEAR(scaled[1].max_translation_m, 0.02, 1e-6);
  const auto turned = CompareRelativeMotion(truth, Drive(5.0, 1.0, 0.01), {1.0}).value();
  EXPECT_NEAR(turned[0].rotation_rad, 0.01, 1e-6);
}

TEST(TrajectoryError, DriftIsAShareOfTheLength) {
  const auto drift = CompareDrift(Drive(35.0, 1.0, 0.0), Drive(35.0, 0.998, 0.0), 300.0).value();
  EXPECT_NEAR(drift.translation_share, 0.002, 1e-6);
  EXPECT_GT(drift.num_stretches, 40);
}

TEST(TrajectoryError, TooShortADriveIsSaid) {
  EXPECT_FALSE(CompareRelativeMotion(Drive(1.0, 1.0, 0.0), Drive(1.0, 1.0, 0.0), {4.0}).ok());
  EXPECT_FALSE(CompareDrift(Drive(1.0, 1.0, 0.0), Drive(1.0, 1.0, 0.0), 300.0).ok());
  EXPECT_FALSE(CompareRelativeMotion(Trajectory(), Drive(1.0, 1.0, 0.0), {0.1}).ok());
}

}  // namespace
}  // namespace scenecalib
