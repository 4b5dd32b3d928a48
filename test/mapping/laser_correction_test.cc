#include "scenecalib/mapping/laser_correction.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr double kRadians = M_PI / 180.0;

Eigen::Vector3d PointAt(double range_m, double azimuth_rad, double elevation_rad) {
  return range_m * Eigen::Vector3d(std::cos(elevation_rad) * std::cos(azimuth_rad),
                                   std::cos(elevation_rad) * std::sin(azimuth_rad),
                                   std::sin(elevation_rad));
}

/// Points at these elevations (degrees), each with a number of its own.
PackedScan ScanAt(const std::vector<double>& elevations_deg) {
  Random random(3);
  LidarScan scan;
  for (const double elevation_deg : elevations_deg) {
    for (int i = 0; i < 500; ++i) {
      LidarPoint point;
      point.position_in_lidar_m =
          PointAt(random.Uniform(3.0, 50.0), random.Uniform(-M_PI, M_PI), kRadians * elevation_deg)
              .cast<float>();
      scan.points.push_back(point);
    }
  }
  return {scan, 1.0, 60.0};
}

TEST(LaserCorrection, FindsEveryLaserWithoutRingNumbers) {
  std::vector<double> elevations_deg;
  for (int i = 0; i < 32; ++i) elevations_deg.push_back(-25.0 + 0.3 * i + 0.02 * i * i);
  const PackedScan scan = ScanAt(elevations_deg);
  const LaserCorrection lasers({&scan});
  ASSERT_EQ(lasers.num_nodes(), elevations_deg.size());
  for (std::size_t i = 0; i < lasers.num_nodes(); ++i) {
    const LaserCorrection::Node& node = lasers.nodes()[i];
    EXPECT_NEAR(std::asin(node.sine_of_elevation) / kRadians, elevations_deg[i], 0.01);
    EXPECT_NEAR(node.share, 1.0 / 32.0, 1e-9);
  }
}

TEST(LaserCorrection, SpreadsNodesWhereLasersDoNotTellApart) {
  std::vector<double> elevations_deg;
  for (int i = 0; i < 400; ++i) elevations_deg.push_back(-10.0 + 0.025 * i);
  const PackedScan scan = ScanAt(elevations_deg);
  const LaserCorrection lasers({&scan});
  EXPECT_GT(lasers.num_nodes(), 20U);
  EXPECT_LT(lasers.num_nodes(), 40U);
}

TEST(LaserCorrection, IsEmptyWithoutPointsOrWithOneLaser) {
  const PackedScan none;
  EXPECT_TRUE(LaserCorrection({&none}).empty());
  const PackedScan one = ScanAt({-3.0});
  const LaserCorrection lasers({&one});
  EXPECT_TRUE(lasers.empty());
  EXPECT_EQ(lasers.Apply({3.0, 2.0, 1.0}), Eigen::Vector3d(3.0, 2.0, 1.0));
}

TEST(LaserCorrection, MovesPointsByRangeAndAnglesOfTheirLaser) {
  const PackedScan scan = ScanAt({-10.0, 0.0, 5.0});
  LaserCorrection lasers({&scan});
  ASSERT_EQ(lasers.num_nodes(), 3U);
  Eigen::VectorXd step = Eigen::VectorXd::Zero(9);
  step.segment<3>(0) << 0.03, 2e-4, -3e-4;
  lasers.Add(0.5 * step);
  lasers.Add(0.5 * step);
  const double elevation = -10.0 * kRadians;
  const Eigen::Vector3d moved = lasers.Apply(PointAt(20.0, 1.0, elevation));
  EXPECT_LT((moved - PointAt(20.03, 1.0 - 3e-4, elevation + 2e-4)).norm(), 2e-5);
  const Eigen::Vector3d other = PointAt(20.0, 1.0, 5.0 * kRadians);
  EXPECT_LT((lasers.Apply(other) - other).norm(), 1e-9);
  // Half way between two lasers half of it.
  const double between = std::asin(0.5 * std::sin(elevation));
  EXPECT_NEAR(lasers.Apply(PointAt(20.0, -2.0, between)).norm(), 20.015, 1e-3);
  EXPECT_NEAR(lasers.RootMeanSquare()[0], 0.03 / std::sqrt(3.0), 1e-3);
  EXPECT_NEAR(lasers.MeanSigma()[0], 0.01, 1e-3);
}

TEST(LaserCorrection, ShrinksWhatIsNoMoreThanTheScenes) {
  const PackedScan scan = ScanAt({-10.0, 0.0, 5.0});
  LaserCorrection lasers({&scan});
  Eigen::VectorXd step = Eigen::VectorXd::Zero(9);
  for (int node = 0; node < 3; ++node) {
    step[3 * node] = node % 2 == 0 ? 0.003 : -0.003;
    step[3 * node + 1] = node % 2 == 0 ? 1e-5 : -1e-5;
  }
  lasers.Add(step);
  lasers.Shrink({0.001, 3e-5, 0.0});
  for (std::size_t node = 0; node < 3; ++node) {
    const double sign = node % 2 == 0 ? 1.0 : -1.0;
    EXPECT_NEAR(lasers.nodes()[node].errors[0], 0.9 * sign * 0.003, 1e-9);
    EXPECT_NEAR(lasers.nodes()[node].errors[1], 0.1 * sign * 1e-5, 1e-12);
    EXPECT_EQ(lasers.nodes()[node].errors[2], 0.0);  // nothing found, nothing unreal
  }
}

}  // namespace
}  // namespace scenecalib
