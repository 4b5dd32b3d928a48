#include "scenecalib/mapping/segment_mapper.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>

#include "mapping/synthetic_drive.h"

namespace scenecalib {
namespace {

constexpr int kNumScans = 24;
constexpr double kDurationS = 2.4;

Rig RigWithImu(const SyntheticDrive& drive) {
  Rig rig;
  rig.lidar.topic = "/points";
  rig.imu = ImuConfig{"/imu", drive.lidar_from_imu};
  return rig;
}

SegmentMapper Feed(const SyntheticDrive& drive, int num_scans, bool with_imu,
                   const MappingOptions& options = {}) {
  Rig rig = RigWithImu(drive);
  if (!with_imu) rig.imu.reset();
  SegmentMapper mapper(rig, options);
  for (const ImuSample& sample : drive.Imu(kDurationS, 200.0, 2)) mapper.AddImu(sample);
  for (const LidarScan& scan : drive.Scans(num_scans, 1)) {
    EXPECT_TRUE(mapper.AddScan(scan).ok());
  }
  return mapper;
}

bool Warns(const MappingResult& result, const std::string& text) {
  return std::any_of(
      result.report.warnings.begin(), result.report.warnings.end(),
      [&text](const std::string& warning) { return warning.find(text) != std::string::npos; });
}

TEST(SegmentMapper, RecoversAKnownDriveWithImu) {
  const SyntheticDrive drive;
  const auto result = Feed(drive, kNumScans, true).BuildMap({});
  ASSERT_TRUE(result.ok()) << result.status().message();
  EXPECT_TRUE(result->report.used_imu);
  EXPECT_EQ(result->report.num_scans_used, kNumScans);
  const Trajectory truth = drive.Truth(kDurationS);
  // Noise of 8000 points a scan and 1 cm allows a fraction of this.
  const Eigen::Vector2d error = RelativeMotionError(result->map.map_from_lidar, truth, 1.0);
  EXPECT_LT(error[0], 2e-3);
  EXPECT_LT(error[1], 2e-4);
  EXPECT_EQ(result->map.relative_motion.size(), 3U);  // the drive is shorter than 4 s
  // The map frame: the first pose's origin, z up.
  const TimedPose& first = result->map.map_from_lidar.poses().front();
  EXPECT_LT(first.map_from_lidar.translation.norm(), 1e-9);
  const Eigen::Quaterniond turn =
      first.map_from_lidar.rotation * truth.poses().front().map_from_lidar.rotation.conjugate();
  EXPECT_LT(std::hypot(LogSo3(turn).x(), LogSo3(turn).y()), 0.01);
}

TEST(SegmentMapper, RecoversAKnownDriveWithoutImu) {
  const SyntheticDrive drive;
  const auto result = Feed(drive, kNumScans, false).BuildMap({});
  ASSERT_TRUE(result.ok()) << result.status().message();
  EXPECT_FALSE(result->report.used_imu);
  const Eigen::Vector2d error =
      RelativeMotionError(result->map.map_from_lidar, drive.Truth(kDurationS), 1.0);
  EXPECT_LT(error[0], 5e-3);
  EXPECT_LT(error[1], 6e-4);
}

TEST(SegmentMapper, TakesScansWhoseMotionTheDriverCompensated) {
  SyntheticDrive drive;
  drive.motion_compensated = true;
  for (const bool with_imu : {true, false}) {
    const auto result = Feed(drive, kNumScans, with_imu).BuildMap({});
    ASSERT_TRUE(result.ok()) << result.status().message();
    EXPECT_EQ(result->map.map_from_lidar.start_ns(), drive.StampAt(0.0));
    const Eigen::Vector2d error =
        RelativeMotionError(result->map.map_from_lidar, drive.Truth(kDurationS), 1.0);
    EXPECT_LT(error[0], 5e-3);
    EXPECT_LT(error[1], 6e-4);
  }
}

TEST(SegmentMapper, CoversEveryPointsTimeDensely) {
  const SyntheticDrive drive;
  MappingOptions options;
  options.refinement.enabled = false;
  const auto result = Feed(drive, 8, true, options).BuildMap({});
  ASSERT_TRUE(result.ok()) << result.status().message();
  const auto& poses = result->map.map_from_lidar.poses();
  EXPECT_EQ(poses.front().stamp_ns, drive.StampAt(0.0));
  EXPECT_GE(poses.back().stamp_ns, drive.StampAt(0.799));
  for (std::size_t i = 1; i < poses.size(); ++i) {
    ASSERT_LE(SecondsBetween(poses[i - 1].stamp_ns, poses[i].stamp_ns), 0.0101);
  }
}

TEST(SegmentMapper, GivesTheSameTrajectoryForAnyNumberOfThreads) {
  const SyntheticDrive drive;
  const SegmentMapper mapper = Feed(drive, 8, true);
  std::vector<std::vector<TimedPose>> results;
  for (const int threads : {1, 2}) {
    tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    const auto result = mapper.BuildMap({});
    ASSERT_TRUE(result.ok()) << result.status().message();
    results.push_back(result->map.map_from_lidar.poses());
  }
  ASSERT_EQ(results[0].size(), results[1].size());
  for (std::size_t i = 0; i < results[0].size(); ++i) {
    ASSERT_EQ(results[0][i].map_from_lidar.translation, results[1][i].map_from_lidar.translation);
  }
}

TEST(SegmentMapper, StatesWhatAGivenTrajectoryIsOffBy) {
  const SyntheticDrive drive;
  std::vector<TimedPose> poses = drive.Truth(kDurationS).poses();
  for (TimedPose& pose : poses) {
    const double t = SecondsBetween(poses.front().stamp_ns, pose.stamp_ns);
    pose.map_from_lidar.translation.x() += 0.03 * std::sin(6.0 * t);
  }
  const auto result =
      Feed(drive, 8, true).BuildMapWithTrajectory(*Trajectory::Create(std::move(poses)), {});
  ASSERT_TRUE(result.ok()) << result.status().message();
  ASSERT_GE(result->map.relative_motion.size(), 2U);
  // Over half a second (1.5 rad to either side) 0.03 m * 2 sin(1.5) / sqrt(2).
  EXPECT_NEAR(result->map.relative_motion[1].translation_m, 0.042, 0.01);
}

TEST(SegmentMapper, KeepsAGivenTrajectory) {
  const SyntheticDrive drive;
  const Trajectory truth = drive.Truth(kDurationS);
  const SegmentMapper mapper = Feed(drive, 8, true);
  const auto result = mapper.BuildMapWithTrajectory(truth, {});
  ASSERT_TRUE(result.ok()) << result.status().message();
  EXPECT_EQ(result->map.map_from_lidar.poses().size(), truth.poses().size());
  // It is right: all that is stated is what the lidar's own would be off by.
  ASSERT_FALSE(result->map.relative_motion.empty());
  for (const RelativeMotionSigma& sigma : result->map.relative_motion) {
    EXPECT_GT(sigma.translation_m, 0.0);
    EXPECT_LT(sigma.translation_m, 3e-3) << sigma.window_s;
    EXPECT_LT(sigma.rotation_rad, 4e-4) << sigma.window_s;
  }
  const auto elsewhere = Trajectory::Create({{1, Rigid3()}, {2, Rigid3()}});
  EXPECT_EQ(mapper.BuildMapWithTrajectory(*elsewhere, {}).status().code(),
            Status::Code::kInsufficientData);
}

MappingResult MapWithOdometry(const SyntheticDrive& drive, bool use_odometry,
                              std::uint64_t seed = 1) {
  Rig rig;
  rig.lidar.topic = "/points";
  rig.odometry = OdometryConfig{"/odometry", drive.lidar_from_body};
  MappingOptions options;
  options.refinement.use_odometry = use_odometry;
  SegmentMapper mapper(rig, options);
  for (const OdometrySample& sample : drive.Odometry(kDurationS, seed + 3)) {
    mapper.AddOdometry(sample);
  }
  for (const LidarScan& scan : drive.Scans(kNumScans, seed)) {
    EXPECT_TRUE(mapper.AddScan(scan).ok());
  }
  const auto result = mapper.BuildMap({});
  EXPECT_TRUE(result.ok()) << result.status().message();
  return *result;
}

TEST(SegmentMapper, LetsOdometryTellTheWayThroughATunnelWithoutFeatures) {
  SyntheticDrive drive;
  drive.boxes = SyntheticDrive::Tunnel();
  const Trajectory truth = drive.Truth(kDurationS);
  struct Case {
    double odometry_scale_error;
    bool use_odometry;
    double square_m2 = 0.0;  ///< error of the motion over a second, summed over the seeds
  };
  // What is left of an error along the tunnel is noise: one seed alone tells little.
  constexpr int kNumSeeds = 6;
  std::array<Case, 3> cases = {{{0.0, true}, {0.01, true}, {0.0, false}}};
  for (Case& c : cases) {
    drive.odometry_scale_error = c.odometry_scale_error;
    for (int seed = 1; seed <= kNumSeeds; ++seed) {
      const MappingResult result = MapWithOdometry(drive, c.use_odometry, seed);
      EXPECT_TRUE(result.report.used_odometry);  // to start registrations from, at least
      const Eigen::Vector2d error = RelativeMotionError(result.map.map_from_lidar, truth, 1.0);
      c.square_m2 += error[0] * error[0];
      EXPECT_LT(error[1], 1e-3);
      // The odometry's scale is unknown there, and without odometry the way, and that is said.
      ASSERT_EQ(result.map.relative_motion.size(), 3U);
      EXPECT_GT(result.map.relative_motion[2].translation_m, error[0]);
      EXPECT_TRUE(Warns(result, "does not fix the motion"));
    }
  }
  const auto rms_m = [](const Case& c) { return std::sqrt(c.square_m2 / kNumSeeds); };
  EXPECT_LT(rms_m(cases[0]), 0.03);
  // Its scale error, one per cent of 6 m, stays.
  EXPECT_LT(rms_m(cases[1]), 0.07);
  // Left alone, the unseen direction stays about where the first registration put it.
  EXPECT_LT(rms_m(cases[0]), 0.3 * rms_m(cases[2]));
}

TEST(SegmentMapper, DoesNotLetOdometrySpoilWhatTheLidarSees) {
  const SyntheticDrive drive;
  const Trajectory truth = drive.Truth(kDurationS);
  const Eigen::Vector2d with =
      RelativeMotionError(MapWithOdometry(drive, true).map.map_from_lidar, truth, 1.0);
  const Eigen::Vector2d without =
      RelativeMotionError(MapWithOdometry(drive, false).map.map_from_lidar, truth, 1.0);
  EXPECT_LT(with[0], 1.1 * without[0]);
  EXPECT_LT(with[1], 1.1 * without[1]);
}

TEST(SegmentMapper, RefusesAStandingVehicleByName) {
  SyntheticDrive drive;
  drive.speed_m_s = 0.0;
  drive.lidar_from_imu = Rigid3();
  const auto result = Feed(drive, 10, false).BuildMap({});
  ASSERT_FALSE(result.ok());
  EXPECT_EQ(result.status().code(), Status::Code::kInsufficientData);
  EXPECT_NE(result.status().message().find("did not move"), std::string::npos);
}

TEST(SegmentMapper, RefusesOneScanAndNoScan) {
  const SyntheticDrive drive;
  EXPECT_EQ(Feed(drive, 1, true).BuildMap({}).status().code(), Status::Code::kInsufficientData);
  EXPECT_EQ(Feed(drive, 0, true).BuildMap({}).status().code(), Status::Code::kInsufficientData);
}

TEST(SegmentMapper, SkipsRepeatedReversedAndEmptyScansAndSaysSo) {
  const SyntheticDrive drive;
  MappingOptions options;
  options.refinement.enabled = false;
  SegmentMapper mapper = Feed(drive, 8, true, options);
  Random random(3);
  EXPECT_EQ(mapper.AddScan(drive.Scan(0.7, &random)).status().code(),
            Status::Code::kInvalidArgument);
  EXPECT_EQ(mapper.AddScan(drive.Scan(0.2, &random)).status().code(),
            Status::Code::kInvalidArgument);
  LidarScan broken = drive.Scan(0.8, &random);
  for (LidarPoint& point : broken.points) {
    point.position_in_lidar_m.x() = std::numeric_limits<float>::quiet_NaN();
  }
  EXPECT_EQ(mapper.AddScan(broken).status().code(), Status::Code::kInvalidArgument);
  EXPECT_EQ(mapper.num_scans(), 8);
  const auto result = mapper.BuildMap({});
  ASSERT_TRUE(result.ok()) << result.status().message();
  ASSERT_FALSE(result->report.warnings.empty());
  EXPECT_NE(result->report.warnings.front().find("3 of 11"), std::string::npos);
}

TEST(SegmentMapper, ForgetsTheOldestScansAtTheBoundAndCountsThem) {
  const SyntheticDrive drive;
  MappingOptions options;
  options.buffer.max_scans = 10;
  options.refinement.enabled = false;
  const auto result = Feed(drive, 14, true, options).BuildMap({});
  ASSERT_TRUE(result.ok()) << result.status().message();
  EXPECT_EQ(result->report.num_scans_dropped_at_bound, 4);
  EXPECT_EQ(result->report.num_scans_used, 10);
}

TEST(SegmentMapper, ForgetsTheOldestScansWhenThereAreTooManyPointsAndSaysSo) {
  const SyntheticDrive drive;
  MappingOptions options;
  options.refinement.enabled = false;
  options.buffer.max_points = 100000;  // a scan has about 8000
  const SegmentMapper mapper = Feed(drive, kNumScans, true, options);
  EXPECT_GT(mapper.num_scans(), 8);
  EXPECT_LT(mapper.num_scans(), 16);
  const auto result = mapper.BuildMap({});
  ASSERT_TRUE(result.ok()) << result.status().message();
  EXPECT_EQ(result->report.num_scans_dropped_at_bound, kNumScans - mapper.num_scans());
  EXPECT_TRUE(Warns(*result, "the oldest"));
  EXPECT_TRUE(Warns(*result, "max_points"));
}

TEST(SegmentMapper, LeavesOutScansEvenlyWhenTheSurfacesWouldGetTooManyPoints) {
  const SyntheticDrive drive;
  MappingOptions options;
  options.refinement.enabled = false;
  const auto all = Feed(drive, 16, true, options).BuildMap({});
  options.buffer.max_surface_points = 100000;  // of 16 scans of about 8000
  options.segment.min_scans = 2;
  const auto some = Feed(drive, 16, true, options).BuildMap({});
  ASSERT_TRUE(all.ok() && some.ok());
  EXPECT_TRUE(Warns(*some, "max_surface_points"));
  EXPECT_FALSE(Warns(*all, "max_surface_points"));
  EXPECT_EQ(some->report.num_scans_used, 16) << "the trajectory keeps all";
  EXPECT_LT(some->map.points.size(), all->map.points.size());
  EXPECT_GT(some->map.points.size(), all->map.points.size() / 2);
  // The last scans' surfaces are there as well as the first ones'.
  const auto farthest = [](const MappingResult& result) {
    float x = 0.0F;
    for (const MapPoint& point : result.map.points) x = std::max(x, point.position_m.x());
    return x;
  };
  EXPECT_NEAR(farthest(*some), farthest(*all), 3.0);
}

TEST(SegmentMapper, BridgesScansThatAreMissingInBetween) {
  const SyntheticDrive drive;
  SegmentMapper mapper(RigWithImu(drive), MappingOptions());
  for (const ImuSample& sample : drive.Imu(kDurationS, 200.0, 2)) mapper.AddImu(sample);
  const std::vector<LidarScan> scans = drive.Scans(kNumScans, 1);
  for (int i = 0; i < kNumScans; ++i) {
    if (i >= 10 && i < 13) continue;
    ASSERT_TRUE(mapper.AddScan(scans[i]).ok());
  }
  const auto result = mapper.BuildMap({});
  ASSERT_TRUE(result.ok()) << result.status().message();
  EXPECT_EQ(result->report.num_scans_used, kNumScans - 3);
  const Eigen::Vector2d error =
      RelativeMotionError(result->map.map_from_lidar, drive.Truth(kDurationS), 1.0);
  // Three scans' time is borne by the IMU and what was seen from both sides.
  EXPECT_LT(error[0], 0.01);
  EXPECT_LT(error[1], 5e-4);
}

TEST(SegmentMapper, SaysThatNoScanCouldBeTracked) {
  const SyntheticDrive drive;
  SegmentMapper mapper(RigWithImu(drive), MappingOptions());
  Random random(5);
  for (int i = 0; i < 12; ++i) {
    LidarScan scan = drive.Scan(0.1 * i, &random);
    for (LidarPoint& point : scan.points) {  // every scan shows another world
      point.position_in_lidar_m =
          Eigen::Vector3d(random.Uniform(-30.0, 30.0), random.Uniform(-30.0, 30.0),
                          random.Uniform(-8.0, 8.0))
              .cast<float>();
    }
    ASSERT_TRUE(mapper.AddScan(scan).ok());
  }
  const auto result = mapper.BuildMap({});
  ASSERT_FALSE(result.ok());
  EXPECT_EQ(result.status().code(), Status::Code::kInsufficientData);
  EXPECT_NE(result.status().message().find("of 12 received"), std::string::npos)
      << result.status().message();
}

TEST(SegmentMapper, DetectsLostTrackingAndUsesTheLongestStretch) {
  const SyntheticDrive drive;
  MappingOptions options;
  options.refinement.enabled = false;
  SegmentMapper mapper = Feed(drive, 12, true, options);
  // The world is suddenly another one: scans turned upside down fit nothing.
  Random random(5);
  for (int i = 12; i < 15; ++i) {
    LidarScan scan = drive.Scan(0.1 * i, &random);
    for (LidarPoint& point : scan.points) {
      point.position_in_lidar_m =
          Eigen::Vector3f(point.position_in_lidar_m.z() * 3.0F, point.position_in_lidar_m.x(),
                          point.position_in_lidar_m.y() * 0.6F);
    }
    const auto registration = mapper.AddScan(scan);
    ASSERT_TRUE(registration.ok()) << registration.status().message();
    EXPECT_FALSE(registration->converged);
  }
  const auto result = mapper.BuildMap({});
  ASSERT_TRUE(result.ok()) << result.status().message();
  EXPECT_EQ(result->report.num_scans_used, 12);
  bool said = false;
  for (const std::string& warning : result->report.warnings) {
    said = said || warning.find("tracking was lost") != std::string::npos;
  }
  EXPECT_TRUE(said);
}

TEST(SegmentMapper, StartsAnewWhenTheClockIsSetBack) {
  const SyntheticDrive drive;
  SegmentMapper mapper = Feed(drive, 12, true);
  int num_refused = 0;
  for (const LidarScan& scan : drive.Scans(12, 1)) num_refused += mapper.AddScan(scan).ok() ? 0 : 1;
  EXPECT_EQ(num_refused, 9);
  EXPECT_EQ(mapper.num_scans(), 3);
}

TEST(SegmentMapper, StopsWhenAskedTo) {
  const SyntheticDrive drive;
  const auto result = Feed(drive, 8, true).BuildMap([](const Progress&) { return false; });
  EXPECT_EQ(result.status().code(), Status::Code::kCancelled);
}

TEST(SegmentMapper, ClonesWithoutTouchingTheOriginal) {
  const SyntheticDrive drive;
  SegmentMapper mapper = Feed(drive, 6, true);
  const SegmentMapper clone = mapper.Clone();
  mapper.Reset();
  EXPECT_EQ(mapper.num_scans(), 0);
  EXPECT_EQ(clone.num_scans(), 6);
}

}  // namespace
}  // namespace scenecalib
