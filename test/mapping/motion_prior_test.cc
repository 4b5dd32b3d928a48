#include "scenecalib/mapping/motion_prior.h"

#include <gtest/gtest.h>

#include <limits>

#include "mapping/synthetic_drive.h"

namespace scenecalib {
namespace {

Rig RigWithImu(const SyntheticDrive& drive) {
  Rig rig;
  rig.imu = ImuConfig{"/imu", drive.lidar_from_imu};
  rig.odometry = OdometryConfig{"/odom", drive.lidar_from_imu};
  return rig;
}

MotionPrior WithImu(SyntheticDrive drive, double rate_hz) {
  drive.gyroscope_bias_rad_s.setZero();
  MotionPrior prior(RigWithImu(drive));
  for (const ImuSample& sample : drive.Imu(1.0, rate_hz, 1)) prior.AddImu(sample);
  return prior;
}

TEST(MotionPrior, IntegratesTheGyroscopeAtAnyRateAndInBothDirections) {
  const SyntheticDrive drive;
  for (const double rate_hz : {200.0, 10.0}) {
    const MotionPrior prior = WithImu(drive, rate_hz);
    const auto rotation = prior.RotationBetween(drive.StampAt(0.123), drive.StampAt(0.456));
    ASSERT_TRUE(rotation.has_value());
    const Eigen::Quaterniond truth =
        drive.WorldFromLidar(0.123).rotation.conjugate() * drive.WorldFromLidar(0.456).rotation;
    // At 10 Hz the rate is linear over 0.1 s and each sample's noise counts for as long.
    EXPECT_LT(RotationAngle(*rotation, truth), rate_hz > 100.0 ? 3e-4 : 2e-3);
    const auto reverse = prior.RotationBetween(drive.StampAt(0.456), drive.StampAt(0.123));
    EXPECT_LT(RotationAngle(*rotation, reverse->conjugate()), 1e-12);
  }
}

TEST(MotionPrior, DoesNotBridgeAGap) {
  const SyntheticDrive drive;
  MotionPrior prior(RigWithImu(drive));
  for (const ImuSample& sample : drive.Imu(1.0, 200.0, 1)) {
    const double t = SecondsBetween(SyntheticDrive::kStartNs, sample.stamp_ns);
    if (t < 0.3 || t > 0.7) prior.AddImu(sample);
  }
  EXPECT_TRUE(prior.RotationBetween(drive.StampAt(0.1), drive.StampAt(0.25)).has_value());
  EXPECT_FALSE(prior.RotationBetween(drive.StampAt(0.2), drive.StampAt(0.8)).has_value());
  EXPECT_FALSE(prior.RotationBetween(drive.StampAt(0.8), drive.StampAt(1.5)).has_value());
  EXPECT_FALSE(prior.RotationBetween(drive.StampAt(-0.5), drive.StampAt(0.1)).has_value());
}

TEST(MotionPrior, SortsLateSamplesAndRefusesRepeatedOrBrokenOnes) {
  const SyntheticDrive drive;
  MotionPrior prior(RigWithImu(drive));
  ImuSample sample;
  for (const double t : {0.0, 0.02, 0.01, 0.02}) {
    sample.stamp_ns = drive.StampAt(t);
    prior.AddImu(sample);
  }
  sample.stamp_ns = drive.StampAt(0.03);
  sample.angular_velocity_rad_s.x() = std::numeric_limits<double>::quiet_NaN();
  prior.AddImu(sample);
  ASSERT_EQ(prior.imu().size(), 3U);
  EXPECT_EQ(prior.imu()[1].stamp_ns, drive.StampAt(0.01));
  EXPECT_EQ(prior.num_refused(), 2);
}

TEST(MotionPrior, TurnsBodyOdometryIntoLidarMotion) {
  const SyntheticDrive drive;
  MotionPrior prior(RigWithImu(drive));
  for (int i = 0; i <= 50; ++i) {
    prior.AddOdometry(
        {drive.StampAt(0.02 * i), drive.WorldFromLidar(0.02 * i) * drive.lidar_from_imu});
  }
  const auto motion = prior.MotionBetween(drive.StampAt(0.2), drive.StampAt(0.7));
  ASSERT_TRUE(motion.has_value());
  const Rigid3 truth = drive.WorldFromLidar(0.2).Inverse() * drive.WorldFromLidar(0.7);
  EXPECT_LT((motion->translation - truth.translation).norm(), 1e-9);
  EXPECT_LT(RotationAngle(motion->rotation, truth.rotation), 1e-9);
  EXPECT_FALSE(prior.MotionBetween(drive.StampAt(0.2), drive.StampAt(1.2)).has_value());
}

TEST(MotionPrior, OdometryCarriesOnToTheEndOfASweepThatItsLastSampleJustMisses) {
  const SyntheticDrive drive;
  MotionPrior prior(RigWithImu(drive));
  for (int i = 0; i <= 50; ++i) {
    prior.AddOdometry(
        {drive.StampAt(0.02 * i), drive.WorldFromLidar(0.02 * i) * drive.lidar_from_imu});
  }
  constexpr double kEnd = 1.015;  // the last sample is at 1.0
  const auto motion = prior.MotionBetween(drive.StampAt(0.9), drive.StampAt(kEnd));
  ASSERT_TRUE(motion.has_value());
  const Rigid3 truth = drive.WorldFromLidar(0.9).Inverse() * drive.WorldFromLidar(kEnd);
  // Half the acceleration times 15 ms times 25 ms stays below 2 mm at 10 m/s^2.
  EXPECT_LT((motion->translation - truth.translation).norm(), 2e-3);
  EXPECT_LT(RotationAngle(motion->rotation, truth.rotation), 2e-3);
}

TEST(MotionPrior, SaysNothingWithoutSensors) {
  MotionPrior prior{Rig{}};
  prior.AddImu({});
  prior.AddOdometry({});
  EXPECT_FALSE(prior.RotationBetween(0, 1).has_value());
  EXPECT_FALSE(prior.MotionBetween(0, 1).has_value());
}

}  // namespace
}  // namespace scenecalib
