#include "scenecalib/mapping/voxel_plane_map.h"

#include <gtest/gtest.h>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

std::vector<Eigen::Vector3d> Floor(double x_from_m, double x_to_m, double height_m,
                                   double noise_m) {
  Random random(1);
  std::vector<Eigen::Vector3d> points;
  for (double x = x_from_m; x < x_to_m; x += 0.1) {
    for (double y = -2.0; y < 2.0; y += 0.1) {
      points.push_back({x, y, height_m + noise_m * random.Gaussian()});
    }
  }
  return points;
}

TEST(VoxelIndex, NumbersKeysInTheOrderOfTheirArrivalAndFindsThemAgain) {
  VoxelIndex index;
  EXPECT_EQ(index.Find(7), VoxelIndex::kNone);
  for (std::uint64_t key = 0; key < 5000; ++key) {
    EXPECT_EQ(index.FindOrAdd(key * key), key);
  }
  EXPECT_EQ(index.FindOrAdd(49), 7U);
  EXPECT_EQ(index.size(), 5000U);
  for (std::uint64_t key = 0; key < 5000; ++key) ASSERT_EQ(index.Find(key * key), key);
  EXPECT_EQ(index.Find(2), VoxelIndex::kNone);
  index.Clear();
  EXPECT_EQ(index.Find(49), VoxelIndex::kNone);
}

TEST(VoxelKey, HoldsThePointOnBothSidesOfTheOriginAndLiesInItsParent) {
  Random random(2);
  for (int i = 0; i < 1000; ++i) {
    const Eigen::Vector3d point(random.Uniform(-900.0, 900.0), random.Uniform(-900.0, 900.0),
                                random.Uniform(-50.0, 50.0));
    const std::uint64_t key = VoxelKey::Of(point, 0.5);
    EXPECT_LE((VoxelKey::Center(key, 0.5) - point).cwiseAbs().maxCoeff(), 0.25 + 1e-9);
    EXPECT_EQ(VoxelKey::Parent(key), VoxelKey::Of(point, 1.0));
  }
}

TEST(VoxelPlaneMap, MeasuresTheDistanceToTheFloor) {
  VoxelPlaneMap map(0.5);
  map.Insert(Floor(0.0, 10.0, 0.1, 0.01));
  PlaneMatch match;
  ASSERT_TRUE(map.Match({5.2, 0.3, 0.15}, 0, &match));
  EXPECT_GT(std::abs(match.normal.z()), 0.99);
  // 25 points of 1 cm fix the plane to a few millimetres.
  EXPECT_NEAR(std::abs(match.distance_m), 0.05, 0.01);
  EXPECT_NEAR(match.sigma_m, 0.01, 0.005);
  EXPECT_FALSE(map.Match({5.2, 30.0, 0.15}, 0, &match));
}

TEST(VoxelPlaneMap, FallsBackToACoarserPlaneWhereTheFineVoxelHasTooFewPoints) {
  VoxelPlaneMap map(0.5);
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) points.push_back({0.25 + 0.5 * i, 0.25 + 0.5 * j, 0.3});
  }
  map.Insert(points);
  PlaneMatch match;
  ASSERT_TRUE(map.Match({0.3, 0.3, 0.35}, 0, &match));
  EXPECT_NEAR(std::abs(match.distance_m), 0.05, 1e-9);
}

TEST(VoxelPlaneMap, AddsPointsOfLaterScansToTheSamePlanes) {
  VoxelPlaneMap one(0.5), two(0.5);
  const auto points = Floor(0.0, 4.0, 0.1, 0.01);
  one.Insert(points);
  const auto half = points.begin() + static_cast<std::ptrdiff_t>(points.size() / 2);
  two.Insert({points.begin(), half});
  two.Insert({half, points.end()});
  EXPECT_EQ(one.num_voxels(), two.num_voxels());
  PlaneMatch a, b;
  ASSERT_TRUE(one.Match({1.1, 0.7, 0.0}, 0, &a));
  ASSERT_TRUE(two.Match({1.1, 0.7, 0.0}, 0, &b));
  EXPECT_NEAR(a.distance_m * a.normal.z(), b.distance_m * b.normal.z(), 0.002);
}

TEST(VoxelPlaneMap, ForgetsWhatIsFarAndKeepsWhatIsNear) {
  VoxelPlaneMap map(0.5);
  map.Insert(Floor(0.0, 40.0, 0.1, 0.01));
  const std::size_t before = map.num_voxels();
  map.ForgetBeyond({30.0, 0.0, 0.0}, 12.0);
  EXPECT_LT(map.num_voxels(), 0.65 * static_cast<double>(before));
  PlaneMatch match;
  EXPECT_TRUE(map.Match({30.2, 0.3, 0.1}, 0, &match));
  EXPECT_FALSE(map.Match({10.2, 0.3, 0.1}, 0, &match));
  map.Insert(Floor(8.0, 12.0, 0.1, 0.01));
  EXPECT_TRUE(map.Match({10.2, 0.3, 0.1}, 0, &match));
  map.Clear();
  EXPECT_TRUE(map.empty());
}

}  // namespace
}  // namespace scenecalib
