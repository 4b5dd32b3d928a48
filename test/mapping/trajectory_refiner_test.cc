#include "scenecalib/mapping/trajectory_refiner.h"

#include <gtest/gtest.h>

#include "mapping/synthetic_drive.h"

namespace scenecalib {
namespace {

constexpr double kDurationS = 2.0;
/// Of the loop's first trajectory.
constexpr double kDriftShare = 1.005;
constexpr double kYawDriftRadS = 0.003;

/// The true trajectory with a smooth error that grows to a decimetre.
PoseSpline Perturbed(const SyntheticDrive& drive) {
  std::vector<TimedPose> poses = drive.Truth(kDurationS).poses();
  for (TimedPose& pose : poses) {
    const double t = SecondsBetween(poses.front().stamp_ns, pose.stamp_ns);
    const Rigid3 error(ExpSo3({0.004 * t, -0.003 * t, 0.004 * std::sin(2.0 * t)}),
                       {0.05 * t, -0.03 * std::sin(3.0 * t), 0.02 * t});
    pose.map_from_lidar = error * pose.map_from_lidar;
  }
  return PoseSpline(*Trajectory::Create(std::move(poses)), 0.05);
}

std::vector<const PackedScan*> PointersTo(const std::vector<PackedScan>& scans) {
  std::vector<const PackedScan*> pointers;
  for (const PackedScan& scan : scans) pointers.push_back(&scan);
  return pointers;
}

struct Fixture {
  SyntheticDrive drive;
  std::vector<LidarScan> scans;
  MotionPrior prior{Rig{}};
  RefinementOptions options;

  explicit Fixture(double imu_rate_hz, const SyntheticDrive& drive_in = SyntheticDrive())
      : drive(drive_in), scans(drive.Scans(20, 1)) {
    if (imu_rate_hz <= 0.0) return;
    Rig rig;
    rig.imu = ImuConfig{"/imu", drive.lidar_from_imu};
    prior = MotionPrior(rig);
    for (const ImuSample& s : drive.Imu(kDurationS, imu_rate_hz, 2)) prior.AddImu(s);
  }
  std::vector<PackedScan> Packed() const {
    std::vector<PackedScan> packed;
    for (const LidarScan& scan : scans) packed.emplace_back(scan, 1.0, 60.0);
    return packed;
  }
  Result<RefinementResult> Refine(const ProgressCallback& progress = {}) const {
    const std::vector<PackedScan> packed = Packed();
    return RefineTrajectory(Perturbed(drive), PointersTo(packed), prior, options, progress);
  }
  Result<LaserCorrection> LasersOfTrueTrajectory() const {
    const std::vector<PackedScan> packed = Packed();
    return EstimateLasers(drive.Truth(kDurationS), PointersTo(packed), options);
  }
  Eigen::Vector2d Error(const PoseSpline& spline, double window_s) const {
    return RelativeMotionError(*Trajectory::Create(spline.Sample(0.005)), drive.Truth(kDurationS),
                               window_s);
  }
};

TEST(TrajectoryRefiner, RemovesASmoothErrorWithAFastSlowOrNoImu) {
  for (const double imu_rate_hz : {200.0, 10.0, 0.0}) {
    const Fixture fixture(imu_rate_hz);
    ASSERT_GT(fixture.Error(Perturbed(fixture.drive), 1.0)[0], 0.03);
    const auto result = fixture.Refine();
    ASSERT_TRUE(result.ok()) << result.status().message();
    const Eigen::Vector2d error = fixture.Error(result->map_from_lidar, 1.0);
    EXPECT_LT(error[0], imu_rate_hz > 100.0 ? 2e-3 : 5e-3) << imu_rate_hz << " Hz";
    EXPECT_LT(error[1], imu_rate_hz > 100.0 ? 2e-4 : 6e-4) << imu_rate_hz << " Hz";
    EXPECT_LT(result->thickness_after_m, result->thickness_before_m);
  }
}

TEST(TrajectoryRefiner, EstimatesBiasesGravityAndNoise) {
  const Fixture fixture(200.0);
  const auto result = fixture.Refine();
  ASSERT_TRUE(result.ok()) << result.status().message();
  // 400 samples of 0.002 rad/s average to 0.0001; the lidar's own turn over 2 s adds to it.
  ASSERT_TRUE(result->gyroscope_bias_rad_s.has_value());
  EXPECT_LT((*result->gyroscope_bias_rad_s - fixture.drive.gyroscope_bias_rad_s).norm(), 5e-4);
  EXPECT_NEAR(result->gyroscope_sigma_rad_s, 0.002, 0.0004);
  EXPECT_NEAR(result->accelerometer_sigma_m_s2, 0.03, 0.01);
  EXPECT_NEAR(result->gravity_in_map_m_s2->norm(), 9.81, 0.1);
}

TEST(TrajectoryRefiner, StatesARelativeMotionErrorOfTheRightSize) {
  const Fixture fixture(200.0);
  const auto result = fixture.Refine();
  ASSERT_TRUE(result.ok()) << result.status().message();
  ASSERT_EQ(result->relative_motion.size(), 3U);  // windows of 0.1, 0.5 and 1 s fit
  for (const RelativeMotionSigma& sigma : result->relative_motion) {
    const Eigen::Vector2d error = fixture.Error(result->map_from_lidar, sigma.window_s);
    EXPECT_GT(sigma.translation_m, 0.25 * error[0]) << sigma.window_s;
    EXPECT_LT(sigma.translation_m, 8.0 * error[0]) << sigma.window_s;
    EXPECT_GT(sigma.rotation_rad, 0.25 * error[1]) << sigma.window_s;
    EXPECT_LT(sigma.rotation_rad, 8.0 * error[1]) << sigma.window_s;
  }
}

double MeanRange_m(const LaserCorrection& lasers) {
  double mean_m = 0.0;
  for (const LaserCorrection::Node& node : lasers.nodes()) mean_m += node.share * node.errors[0];
  return mean_m;
}

TEST(TrajectoryRefiner, FindsWhatLasersAreOffBy) {
  SyntheticDrive drive;
  drive.ring_range_m = 0.02;
  drive.ring_elevation_rad = 1e-3;
  Fixture fixture(200.0, drive);
  const auto result = fixture.Refine();
  ASSERT_TRUE(result.ok()) << result.status().message();
  ASSERT_EQ(result->lasers.num_nodes(), 24U);
  double sum = 0.0;
  for (std::size_t i = 0; i < 24; ++i) {
    const double sign = i % 2 == 0 ? 1.0 : -1.0;
    sum += sign * result->lasers.nodes()[i].errors[0] / 24.0;
  }
  // What is to be added is what was measured too much, taken away.
  EXPECT_NEAR(sum, -0.02, 0.008);
  EXPECT_NEAR(MeanRange_m(result->lasers), 0.0, 5e-6);

  fixture.options.estimate_lasers = false;
  const auto without = fixture.Refine();
  ASSERT_TRUE(without.ok()) << without.status().message();
  EXPECT_TRUE(without->lasers.empty());
  EXPECT_LT(result->thickness_after_m, 0.8 * without->thickness_after_m);
  EXPECT_LT(fixture.Error(result->map_from_lidar, 1.0)[0],
            fixture.Error(without->map_from_lidar, 1.0)[0]);
}

TEST(EstimateLasers, FindsWhatTheyAreOffByOnAKnownTrajectory) {
  SyntheticDrive drive;
  drive.ring_range_m = 0.02;
  drive.ring_elevation_rad = 1e-3;
  const auto lasers = Fixture(0.0, drive).LasersOfTrueTrajectory();
  ASSERT_TRUE(lasers.ok()) << lasers.status().message();
  ASSERT_EQ(lasers->num_nodes(), 24U);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < 24; ++i) {
    sum += (i % 2 == 0 ? 1.0 : -1.0) * lasers->nodes()[i].errors / 24.0;
  }
  EXPECT_NEAR(sum[0], -0.02, 0.004);
  EXPECT_NEAR(MeanRange_m(*lasers), 0.0, 5e-6);
  const auto right = Fixture(0.0).LasersOfTrueTrajectory();
  ASSERT_TRUE(right.ok()) << right.status().message();
  EXPECT_LT(right->RootMeanSquare()[0], 2e-4);
  EXPECT_LT(right->RootMeanSquare()[1], 2e-5);
}

TEST(EstimateLasers, RefusesASingleScan) {
  Fixture fixture(0.0);
  fixture.scans.resize(1);
  EXPECT_EQ(fixture.LasersOfTrueTrajectory().status().code(), Status::Code::kInsufficientData);
}

TEST(TrajectoryRefiner, FindsNothingOfLasersThatAreRight) {
  const auto result = Fixture(200.0).Refine();
  ASSERT_TRUE(result.ok()) << result.status().message();
  const LaserCorrection::Errors errors = result->lasers.RootMeanSquare();
  EXPECT_LT(errors[0], 2e-4);
  EXPECT_LT(errors[1], 2e-5);
  EXPECT_LT(errors[2], 2e-5);
}

TEST(TrajectoryRefiner, RefusesASceneWithoutPlanes) {
  Fixture fixture(200.0);
  Random random(7);
  for (LidarScan& scan : fixture.scans) {
    for (LidarPoint& point : scan.points) {
      point.position_in_lidar_m =
          Eigen::Vector3d(random.Uniform(-20.0, 20.0), random.Uniform(-20.0, 20.0),
                          random.Uniform(-5.0, 5.0))
              .cast<float>();
    }
  }
  EXPECT_EQ(fixture.Refine().status().code(), Status::Code::kInsufficientData);
}

/// Once around a loop and a quarter more, from a trajectory that drifts as an odometry would.
TEST(TrajectoryRefiner, ClosesALoopWhereAPlaceIsVisitedAgain) {
  SyntheticDrive drive;
  drive.loop_radius_m = 18.0;
  drive.speed_m_s = 12.0;
  drive.boxes = SyntheticDrive::Ring(drive.loop_radius_m);
  drive.num_columns = 180;
  const double lap_s = 2.0 * M_PI * drive.loop_radius_m / drive.speed_m_s;
  const int num_scans = static_cast<int>(10.0 * 1.25 * lap_s);
  const double duration_s = 0.1 * num_scans;
  std::vector<TimedPose> poses = drive.Truth(duration_s).poses();
  Rigid3 drifting = poses.front().map_from_lidar;
  std::vector<TimedPose> drifted = {poses.front()};
  for (std::size_t i = 1; i < poses.size(); ++i) {
    Rigid3 step = poses[i - 1].map_from_lidar.Inverse() * poses[i].map_from_lidar;
    step.translation *= kDriftShare;
    step.rotation = step.rotation * ExpSo3({0.0, 0.0, kYawDriftRadS * 0.005});
    drifting = drifting * step;
    drifted.push_back({poses[i].stamp_ns, drifting});
  }
  const Trajectory truth = drive.Truth(duration_s);
  const auto initial = Trajectory::Create(drifted);
  const auto lap_error = [&](const Trajectory& trajectory) {
    return RelativeMotionError(trajectory, truth, lap_s)[0];
  };
  std::vector<PackedScan> packed;
  for (const LidarScan& scan : drive.Scans(num_scans, 1)) packed.emplace_back(scan, 1.0, 60.0);
  std::vector<const PackedScan*> pointers;
  for (const PackedScan& scan : packed) pointers.push_back(&scan);
  const auto result =
      RefineTrajectory(PoseSpline(*initial, 0.05), pointers, MotionPrior{Rig{}}, {}, {});
  ASSERT_TRUE(result.ok()) << result.status().message();
  const double before_m = lap_error(*initial);
  const double after_m = lap_error(*Trajectory::Create(result->map_from_lidar.Sample(0.005)));
  EXPECT_GT(before_m, 0.4);
  EXPECT_LT(after_m, 5e-3);
}

TEST(TrajectoryRefiner, StopsWhenAskedTo) {
  const Fixture fixture(200.0);
  EXPECT_EQ(fixture.Refine([](const Progress&) { return false; }).status().code(),
            Status::Code::kCancelled);
}

}  // namespace
}  // namespace scenecalib
