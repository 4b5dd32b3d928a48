#include "../../src/mapping/start_velocity.h"

#include <gtest/gtest.h>

#include "../../src/mapping/sweep_sampler.h"
#include "mapping/odometry_scenes.h"

namespace scenecalib::testing {
namespace {

constexpr SweepSampling kSampling{3.0, 120.0, 0.2, 0.6};

/// A sweep as the odometry prepares it.
struct PreparedSweep {
  SweepSamples samples;
  std::vector<SweepPoint> source;
  SweepMotion motion;

  PreparedSweep(const LidarScan& scan, const MotionPrior& prior)
      : samples(SampleSweep(scan, kSampling)), motion(samples, prior) {
    for (const std::uint32_t i : samples.sparse) source.push_back(samples.points[i]);
  }
  StartSweep View() const { return {samples, source, motion}; }
};

StartVelocity Search(const Scene& scene, const Motion& scene_from_lidar) {
  const MotionPrior prior{Rig{}};
  const SceneLidar lidar;
  Random random(5);
  const PreparedSweep first(lidar.Sweep(scene, scene_from_lidar, 0.0, &random), prior);
  const PreparedSweep second(lidar.Sweep(scene, scene_from_lidar, lidar.period_s, &random), prior);
  const LastSweep last{Rigid3::Identity(), {}, false, first.samples.mid_ns};
  return SearchStartVelocity(first.View(), second.View(), last, prior, {});
}

TEST(StartVelocity, IsWhatLeadsToTheBestPlaceAndNotOneOfTheTrials) {
  // Trials are 8 m/s apart; their best place is known to centimetres in 0.1 s.
  constexpr double kToleranceM_s = 0.6;
  for (const double speed_m_s : {0.0, 4.0, 12.0, 21.0, 28.0}) {
    const StartVelocity found = Search(BoxStreet(), StraightAt(speed_m_s));
    EXPECT_LT((found.velocity.linear_m_s - Eigen::Vector3d(speed_m_s, 0.0, 0.0)).norm(),
              kToleranceM_s)
        << speed_m_s;
    EXPECT_FALSE(found.open_direction_in_map) << speed_m_s;
  }
}

TEST(StartVelocity, SaysThatATunnelHidesIt) {
  const StartVelocity found = Search(SmoothTunnel(), StraightAt(12.0));
  ASSERT_TRUE(found.open_direction_in_map);
  EXPECT_GT(std::abs(found.open_direction_in_map->x()), 0.99);
}

}  // namespace
}  // namespace scenecalib::testing
