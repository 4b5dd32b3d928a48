#include "scenecalib/mapping/lidar_odometry.h"

#include <gtest/gtest.h>

#include "mapping/synthetic_drive.h"

namespace scenecalib {
namespace {

TEST(LidarOdometry, FindsTheSpeedOfAMovingStartWithoutAnyPrior) {
  const SyntheticDrive drive;
  LidarOdometry odometry{OdometryOptions{}};
  const MotionPrior prior{Rig{}};
  std::vector<SweepRegistration> sweeps;
  for (const LidarScan& scan : drive.Scans(6, 1)) {
    const auto sweep = odometry.Register(scan, prior);
    ASSERT_TRUE(sweep.ok()) << sweep.status().message();
    ASSERT_TRUE(sweep->converged);
    sweeps.push_back(*sweep);
  }
  // Between middles of sweeps, and within one: the motion is known from the second scan on.
  for (std::size_t i = 1; i < sweeps.size(); ++i) {
    const double t0 = SecondsBetween(SyntheticDrive::kStartNs, sweeps[i - 1].mid_ns());
    const double t1 = SecondsBetween(SyntheticDrive::kStartNs, sweeps[i].mid_ns());
    const Rigid3 truth = drive.WorldFromLidar(t0).Inverse() * drive.WorldFromLidar(t1);
    const Rigid3 motion = sweeps[i - 1].map_from_lidar.Inverse() * sweeps[i].map_from_lidar;
    EXPECT_LT((motion.translation - truth.translation).norm(), 0.03) << i;
    EXPECT_LT(RotationAngle(motion.rotation, truth.rotation), 0.004) << i;
    const Rigid3 within =
        sweeps[i].poses.front().map_from_lidar.Inverse() * sweeps[i].poses.back().map_from_lidar;
    EXPECT_NEAR(within.translation.norm(), 0.6, 0.03) << i;
  }
}

TEST(LidarOdometry, TurnsItsMapUpright) {
  std::vector<Eigen::Vector3d> ground;
  const Eigen::Quaterniond tilt = ExpSo3({0.1, -0.15, 0.0});
  for (double x = -15.0; x < 15.0; x += 0.7) {
    for (double y = -8.0; y < 8.0; y += 0.7) {
      ground.push_back(tilt.conjugate() * Eigen::Vector3d(x, y, -2.0));
      if (std::abs(y) > 7.0) ground.push_back(tilt.conjugate() * Eigen::Vector3d(x, y, -1.0));
    }
  }
  const Eigen::Vector3d up = EstimateUpFromGround(ground);
  EXPECT_LT((up - tilt.conjugate() * Eigen::Vector3d::UnitZ()).norm(), 0.01);
  EXPECT_EQ(EstimateUpFromGround({}), Eigen::Vector3d::UnitZ());
}

TEST(LidarOdometry, RefusesTooFewPointsByNumber) {
  LidarOdometry odometry{OdometryOptions{}};
  LidarScan scan;
  scan.stamp_ns = 1;
  const auto sweep = odometry.Register(scan, MotionPrior{Rig{}});
  EXPECT_EQ(sweep.status().code(), Status::Code::kInvalidArgument);
  EXPECT_NE(sweep.status().message().find("0 points"), std::string::npos);
}

}  // namespace
}  // namespace scenecalib
