#include "../../src/mapping/lidar_return.h"

#include <gtest/gtest.h>

#include <map>
#include <vector>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

std::vector<LidarReturn> PointsWithin(double half_edge_m, int count) {
  Random random(4);
  std::vector<LidarReturn> points(count);
  for (LidarReturn& point : points) {
    for (int axis = 0; axis < 3; ++axis) {
      point.position_m[axis] = static_cast<float>(random.Uniform(-half_edge_m, half_edge_m));
    }
  }
  return points;
}

/// What GroupByVoxel says, as an ordered map says it.
void ExpectGroups(const std::vector<LidarReturn>& points, const std::vector<int>& indices,
                  double voxel_size_m) {
  std::map<std::uint64_t, std::vector<int>> expected;
  for (const int i : indices) {
    expected[VoxelKey(points[i].position_m, static_cast<float>(1.0 / voxel_size_m))].push_back(i);
  }
  const VoxelGroups groups = GroupByVoxel(points, indices, voxel_size_m);
  ASSERT_EQ(groups.size(), static_cast<int>(expected.size()));
  ASSERT_EQ(groups.begin.size(), expected.size() + 1);
  int v = 0;
  for (const auto& [key, members] : expected) {
    EXPECT_EQ(groups.keys[v], key);
    EXPECT_EQ(groups.Find(key), v);
    EXPECT_EQ(std::vector<int>(groups.order.begin() + groups.begin[v],
                               groups.order.begin() + groups.begin[v + 1]),
              members);
    ++v;
  }
}

std::vector<int> EverySecondBackwards(int count) {
  std::vector<int> indices;
  for (int i = count - 1; i >= 0; i -= 2) indices.push_back(i);
  return indices;
}

TEST(GroupByVoxel, KeepsTheOrderWithinAVoxel) {
  const auto points = PointsWithin(2.0, 3000);
  ExpectGroups(points, EverySecondBackwards(3000), 0.4);
}

TEST(GroupByVoxel, GroupsAWholeTown) {
  // More voxels in the box than 32 bits count.
  const auto points = PointsWithin(3000.0, 500);
  ExpectGroups(points, EverySecondBackwards(500), 0.1);
  ExpectGroups(points, EverySecondBackwards(500), 50.0);
}

TEST(GroupByVoxel, TakesOnePointAndNone) {
  const auto points = PointsWithin(2.0, 1);
  ExpectGroups(points, {0}, 0.4);
  ExpectGroups(points, {}, 0.4);
}

TEST(VoxelKey, RoundsDownOnBothSidesOfTheOrigin) {
  const auto key = [](float x) { return VoxelKey({x, 0.0F, 0.0F}, 1.0F); };
  EXPECT_EQ(key(-0.5F), key(-1.0F));
  EXPECT_EQ(key(-0.5F), NeighborVoxelKey(key(0.5F), -1, 0, 0));
  EXPECT_EQ(key(-1.5F), NeighborVoxelKey(key(-1.0F), -1, 0, 0));
  EXPECT_EQ(key(2.0F), NeighborVoxelKey(key(1.9F), 1, 0, 0));
}

}  // namespace
}  // namespace scenecalib
