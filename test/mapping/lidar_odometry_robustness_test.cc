#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <limits>

#include "mapping/odometry_scenes.h"
#include "scenecalib/mapping/lidar_odometry.h"

namespace scenecalib::testing {
namespace {

// Scans of 6000 points with 1 cm noise place a sweep to within a millimetre or two.
constexpr double kPlaceToleranceM = 0.008;
constexpr double kTurnToleranceRad = 1e-3;

Motion TurningOnTheSpot(double rate_rad_s) {
  return [rate_rad_s](double t) {
    return Rigid3(ExpSo3({0.0, 0.0, rate_rad_s * t}), {3.0, 0.5, 2.0});
  };
}

TEST(LidarOdometryRobustness, StartsOnAVehicleThatMovesAlreadyAtAnySpeed) {
  for (const double speed_m_s : {0.0, 8.0, 20.0, 30.0}) {
    const OdometryRun run = RunOdometry(BoxStreet(), StraightAt(speed_m_s), 11);
    ASSERT_EQ(run.sweeps.size(), 11U);
    EXPECT_TRUE(run.AllConverged()) << speed_m_s;
    EXPECT_LT(run.WorstTranslation_m(), kPlaceToleranceM) << speed_m_s;
    EXPECT_LT(run.WorstRotation_rad(), kTurnToleranceRad) << speed_m_s;
  }
}

TEST(LidarOdometryRobustness, FollowsAVehicleThatTurnsOnTheSpot) {
  for (const double rate_rad_s : {0.5, 2.0}) {
    const OdometryRun run = RunOdometry(BoxStreet(), TurningOnTheSpot(rate_rad_s), 20);
    EXPECT_TRUE(run.AllConverged()) << rate_rad_s;
    EXPECT_LT(run.WorstTranslation_m(), kPlaceToleranceM) << rate_rad_s;
    EXPECT_LT(run.WorstRotation_rad(), kTurnToleranceRad) << rate_rad_s;
  }
}

TEST(LidarOdometryRobustness, StandsStillWithoutDrift) {
  const OdometryRun run = RunOdometry(BoxStreet(), StraightAt(0.0), 20);
  EXPECT_TRUE(run.AllConverged());
  EXPECT_LT(run.WorstTranslation_m(), 0.003);
  for (const SweepRegistration& sweep : run.sweeps) {
    const Rigid3 within =
        sweep.poses.front().map_from_lidar.Inverse() * sweep.poses.back().map_from_lidar;
    EXPECT_LT(within.translation.norm(), 0.01);
  }
}

TEST(LidarOdometryRobustness, WorksUpsideDownAndKeepsItsMapUpright) {
  SceneLidar lidar;
  lidar.body_from_lidar = Rigid3(ExpSo3({M_PI, 0.0, 0.0}), Eigen::Vector3d::Zero());
  const OdometryRun run = RunOdometry(BoxStreet(), StraightAt(8.0), 12, lidar);
  EXPECT_TRUE(run.AllConverged());
  EXPECT_LT(run.WorstTranslation_m(), kPlaceToleranceM);
  const Eigen::Vector3d lidar_z_in_map =
      run.sweeps.front().map_from_lidar.rotation * Eigen::Vector3d::UnitZ();
  EXPECT_LT(lidar_z_in_map.z(), -0.999);
}

TEST(LidarOdometryRobustness, WorksWithAQuarterOfTheTurnEmpty) {
  SceneLidar lidar;
  lidar.empty_from_share = 0.75;
  const OdometryRun run = RunOdometry(BoxStreet(), StraightAt(8.0), 12, lidar);
  EXPECT_TRUE(run.AllConverged());
  EXPECT_LT(run.WorstTranslation_m(), kPlaceToleranceM);
}

TEST(LidarOdometryRobustness, PlacesPointsTheSameWhicheverPointTheStampBelongsTo) {
  const OdometryRun first = RunOdometry(BoxStreet(), StraightAt(8.0), 6);
  for (const double share : {0.5, 1.0}) {
    SceneLidar lidar;
    lidar.stamp_share = share;
    const OdometryRun run = RunOdometry(BoxStreet(), StraightAt(8.0), 6, lidar);
    ASSERT_EQ(run.sweeps.size(), first.sweeps.size());
    for (std::size_t i = 0; i < run.sweeps.size(); ++i) {
      EXPECT_NEAR(SecondsBetween(first.sweeps[i].stamp_ns, run.sweeps[i].stamp_ns), 0.1 * share,
                  1e-9);
      // Times are single precision: 10 ns.
      EXPECT_NEAR(SecondsBetween(first.sweeps[i].mid_ns(), run.sweeps[i].mid_ns()), 0.0, 2e-8);
      EXPECT_LT(
          (run.sweeps[i].map_from_lidar.translation - first.sweeps[i].map_from_lidar.translation)
              .norm(),
          1e-4);
    }
  }
}

TEST(LidarOdometryRobustness, NamesTheOpenDirectionOfATunnelAndFollowsTheOdometryAlongIt) {
  constexpr double kScaleError = 0.01;
  const Motion motion = StraightAt(8.0);
  const OdometryRun run =
      RunOdometry(SmoothTunnel(), motion, 20, {}, WithOdometry(motion, 3.0, kScaleError));
  ASSERT_EQ(run.sweeps.size(), 20U);
  for (std::size_t i = 1; i < run.sweeps.size(); ++i) {
    const SweepRegistration& sweep = run.sweeps[i];
    EXPECT_TRUE(sweep.converged);
    ASSERT_EQ(sweep.degenerate_directions_in_map.size(), 1U) << i;
    EXPECT_GT(std::abs(sweep.degenerate_directions_in_map[0].x()), 0.999) << i;
    EXPECT_TRUE(sweep.degenerate_axes_in_map.empty()) << i;
    // Forward what the odometry says; across and upwards what the walls say.
    const Eigen::Vector3d error = run.ErrorBetween(0, i).translation;
    EXPECT_NEAR(error.x(), kScaleError * 0.8 * static_cast<double>(i), 0.005) << i;
    EXPECT_LT(error.tail<2>().norm(), 0.003) << i;
  }
}

TEST(LidarOdometryRobustness, SaysThatATunnelHidesTheSpeedWhenThereIsNoOdometryEither) {
  const OdometryRun run = RunOdometry(SmoothTunnel(), StraightAt(8.0), 10);
  for (std::size_t i = 1; i < run.sweeps.size(); ++i) {
    ASSERT_FALSE(run.sweeps[i].degenerate_directions_in_map.empty()) << i;
    EXPECT_GT(std::abs(run.sweeps[i].degenerate_directions_in_map[0].x()), 0.99) << i;
  }
}

TEST(LidarOdometryRobustness, FindsThatAnOpenFieldFixesHeightAndTiltOnly) {
  const Motion motion = StraightAt(8.0);
  const OdometryRun run = RunOdometry(OpenField(), motion, 6, {}, WithOdometry(motion, 2.0, 0.0));
  for (std::size_t i = 1; i < run.sweeps.size(); ++i) {
    EXPECT_EQ(run.sweeps[i].degenerate_directions_in_map.size(), 2U);
    ASSERT_EQ(run.sweeps[i].degenerate_axes_in_map.size(), 1U);
    EXPECT_GT(std::abs(run.sweeps[i].degenerate_axes_in_map[0].z()), 0.999);
  }
  EXPECT_LT(run.WorstTranslation_m(), 0.005);
}

TEST(LidarOdometryRobustness, FindsNoOpenDirectionOnAStreet) {
  for (const SweepRegistration& sweep : RunOdometry(BoxStreet(), StraightAt(8.0), 12).sweeps) {
    EXPECT_TRUE(sweep.degenerate_directions_in_map.empty());
    EXPECT_TRUE(sweep.degenerate_axes_in_map.empty());
  }
}

TEST(LidarOdometryRobustness, SaysSoWhenTrackingIsLostAndPredictsMeanwhile) {
  LidarOdometry odometry{OdometryOptions{}};
  const MotionPrior prior{Rig{}};
  const SceneLidar lidar;
  Random random(3);
  for (int i = 0; i < 6; ++i) {
    ASSERT_TRUE(
        odometry.Register(lidar.Sweep(BoxStreet(), StraightAt(8.0), 0.1 * i, &random), prior)
            ->converged);
  }
  LidarScan elsewhere = lidar.Sweep(BoxStreet(), StraightAt(8.0), 0.6, &random);
  for (LidarPoint& point : elsewhere.points) {
    const Eigen::Vector3f p = point.position_in_lidar_m;
    point.position_in_lidar_m = {3.0F * p.z(), p.x(), 0.6F * p.y()};
  }
  const auto lost = odometry.Register(elsewhere, prior);
  ASSERT_TRUE(lost.ok());
  EXPECT_FALSE(lost->converged);
  EXPECT_NEAR(lost->map_from_lidar.translation.x(), 4.8, 0.05);
  const auto found =
      odometry.Register(lidar.Sweep(BoxStreet(), StraightAt(8.0), 0.7, &random), prior);
  EXPECT_TRUE(found->converged);
  EXPECT_EQ(found->stretch, 0);
  EXPECT_NEAR(found->map_from_lidar.translation.x(), 5.6, 0.01);
}

TEST(LidarOdometryRobustness, StartsAnewAfterTooManyLostScans) {
  OdometryOptions options;
  options.max_lost_scans = 2;
  LidarOdometry odometry{options};
  const MotionPrior prior{Rig{}};
  const SceneLidar lidar;
  Random random(3);
  // After four scans the vehicle is suddenly 31 m farther on and turned about.
  const Motion motion = [](double t) {
    return t < 0.35 ? StraightAt(8.0)(t)
                    : Rigid3(ExpSo3({0.0, 0.0, 2.0}), {31.0 + 8.0 * t, 3.0, 2.0});
  };
  std::vector<SweepRegistration> sweeps;
  for (int i = 0; i < 10; ++i) {
    const auto sweep = odometry.Register(lidar.Sweep(BoxStreet(), motion, 0.1 * i, &random), prior);
    ASSERT_TRUE(sweep.ok());
    sweeps.push_back(*sweep);
  }
  EXPECT_FALSE(sweeps[4].converged);
  EXPECT_FALSE(sweeps[5].converged);
  EXPECT_EQ(sweeps[5].stretch, 0);
  for (std::size_t i = 6; i < sweeps.size(); ++i) {
    EXPECT_TRUE(sweeps[i].converged) << i;
    EXPECT_EQ(sweeps[i].stretch, 1) << i;
  }
  const Rigid3 motion_after = sweeps[6].map_from_lidar.Inverse() * sweeps[9].map_from_lidar;
  EXPECT_NEAR(motion_after.translation.norm(), 2.4, 0.01);
}

class StampTest : public ::testing::Test {
 protected:
  Result<SweepRegistration> RegisterAt(double seconds) {
    LidarScan scan = lidar_.Sweep(BoxStreet(), StraightAt(0.0), 0.0, &random_);
    scan.stamp_ns = AddSeconds(SyntheticDrive::kStartNs, seconds);
    return odometry_.Register(scan, MotionPrior{Rig{}});
  }
  SceneLidar lidar_;
  Random random_{5};
  LidarOdometry odometry_{OdometryOptions{}};
};

TEST_F(StampTest, RefusesRepeatedAndReversedStamps) {
  ASSERT_TRUE(RegisterAt(1.0).ok());
  for (const double seconds : {1.0, 0.9, -1000.0}) {
    const auto sweep = RegisterAt(seconds);
    EXPECT_EQ(sweep.status().code(), Status::Code::kInvalidArgument);
    EXPECT_NE(sweep.status().message().find("not later"), std::string::npos);
  }
  EXPECT_TRUE(RegisterAt(1.1).ok());
}

TEST_F(StampTest, RefusesAStrayStampFromTheFutureAndCarriesOn) {
  for (const double seconds : {0.0, 0.1, 0.2}) ASSERT_TRUE(RegisterAt(seconds).ok());
  for (const double stray : {4000.3, 2.0}) {
    const auto refused = RegisterAt(stray);
    ASSERT_EQ(refused.status().code(), Status::Code::kInvalidArgument);
    EXPECT_NE(refused.status().message().find("after the one before it"), std::string::npos);
    const auto next = RegisterAt(stray == 2.0 ? 0.4 : 0.3);
    ASSERT_TRUE(next.ok()) << next.status().message();
    EXPECT_TRUE(next->converged);
    EXPECT_EQ(next->stretch, 0);
  }
}

TEST_F(StampTest, BelievesAPauseThatTheNextScanConfirms) {
  for (const double seconds : {0.0, 0.1, 0.2}) ASSERT_TRUE(RegisterAt(seconds).ok());
  EXPECT_FALSE(RegisterAt(2.2).ok());
  const auto after_pause = RegisterAt(2.3);
  ASSERT_TRUE(after_pause.ok());
  EXPECT_TRUE(after_pause->converged);
  EXPECT_EQ(after_pause->stretch, 0);
  // Minutes later the vehicle may be anywhere: a new stretch.
  EXPECT_FALSE(RegisterAt(300.0).ok());
  const auto much_later = RegisterAt(300.1);
  ASSERT_TRUE(much_later.ok());
  EXPECT_EQ(much_later->stretch, 1);
}

TEST_F(StampTest, TakesALidarOfAnySweepRate) {
  ASSERT_TRUE(RegisterAt(0.0).ok());
  EXPECT_FALSE(RegisterAt(2.0).ok());
  for (const double seconds : {4.0, 6.0, 8.0, 10.0}) EXPECT_TRUE(RegisterAt(seconds).ok());
}

TEST(LidarOdometryRobustness, RefusesScansOfNothingButNanAndCarriesOn) {
  LidarOdometry odometry{OdometryOptions{}};
  const MotionPrior prior{Rig{}};
  const SceneLidar lidar;
  Random random(3);
  for (int i = 0; i < 8; ++i) {
    LidarScan scan = lidar.Sweep(BoxStreet(), StraightAt(8.0), 0.1 * i, &random);
    if (i == 0 || i == 4) {
      for (LidarPoint& point : scan.points) {
        point.position_in_lidar_m.setConstant(std::numeric_limits<float>::quiet_NaN());
      }
    }
    const auto sweep = odometry.Register(scan, prior);
    EXPECT_EQ(sweep.ok(), i != 0 && i != 4) << i;
    if (i == 7) {
      EXPECT_NEAR(sweep->map_from_lidar.translation.x(), 4.8, 0.01);
    }
  }
}

TEST(LidarOdometryRobustness, GivesTheSamePosesForAnyNumberOfThreads) {
  std::vector<OdometryRun> runs;
  for (const int threads : {1, 2, 4}) {
    tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    runs.push_back(RunOdometry(BoxStreet(), StraightAt(8.0), 6));
  }
  for (std::size_t run = 1; run < runs.size(); ++run) {
    for (std::size_t i = 0; i < runs[0].sweeps.size(); ++i) {
      const Rigid3& a = runs[0].sweeps[i].map_from_lidar;
      const Rigid3& b = runs[run].sweeps[i].map_from_lidar;
      ASSERT_EQ(a.translation, b.translation);
      ASSERT_EQ(a.rotation.coeffs(), b.rotation.coeffs());
    }
  }
}

}  // namespace
}  // namespace scenecalib::testing
