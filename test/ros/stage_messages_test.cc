#include "scenecalib/ros/stage_messages.h"

#include <gtest/gtest.h>

namespace scenecalib {
namespace {

SceneMap SmallMap() {
  SceneMap map;
  map.map_from_lidar =
      *Trajectory::Create({{1'000'000'000, Rigid3::Identity()},
                           {2'000'000'000, Rigid3({0.6, 0.0, 0.8, 0.0}, {1, 2, 3})}});
  map.ground.vertices_m = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  map.ground.triangles = {{0, 1, 2}};
  Surfel surfel;
  surfel.center_m = {4, 5, 6};
  surfel.radius_m = 0.4F;
  surfel.num_points = 17;
  surfel.planar = false;
  map.surfels = {surfel};
  map.points = {{{7, 8, 9}, 0.5F}};
  map.relative_motion = {{1.0, 2e-3, 3e-5}};
  map.lidar_frame = {4e-3, 5e-5};
  return map;
}

TEST(MapMessage, HandsOnAllThatACalibrationUses) {
  const SceneMap map = SmallMap();
  const auto returned = FromMessage(ToMessage(map, "map"));
  ASSERT_TRUE(returned.ok()) << returned.status().message();
  ASSERT_EQ(returned->map_from_lidar.poses().size(), 2U);
  EXPECT_EQ(returned->map_from_lidar.end_ns(), map.map_from_lidar.end_ns());
  EXPECT_EQ(returned->map_from_lidar.poses()[1].map_from_lidar.translation,
            map.map_from_lidar.poses()[1].map_from_lidar.translation);
  EXPECT_EQ(returned->ground.vertices_m, map.ground.vertices_m);
  EXPECT_EQ(returned->ground.triangles, map.ground.triangles);
  ASSERT_EQ(returned->surfels.size(), 1U);
  EXPECT_EQ(returned->surfels[0].center_m, map.surfels[0].center_m);
  EXPECT_EQ(returned->surfels[0].num_points, 17);
  EXPECT_FALSE(returned->surfels[0].planar);
  ASSERT_EQ(returned->points.size(), 1U);
  EXPECT_EQ(returned->points[0].position_m, map.points[0].position_m);
  ASSERT_EQ(returned->relative_motion.size(), 1U);
  EXPECT_EQ(returned->relative_motion[0].rotation_rad, 3e-5);
  EXPECT_EQ(returned->lidar_frame.translation_m, 4e-3);
  EXPECT_EQ(returned->lidar_frame.rotation_rad, 5e-5);
}

TEST(MapMessage, IsRefusedWhenArraysAreCutOff) {
  MapSnapshot message = ToMessage(SmallMap(), "map");
  message.points.pop_back();
  EXPECT_FALSE(FromMessage(message).ok());
  message = ToMessage(SmallMap(), "map");
  message.trajectory_stamps.pop_back();
  EXPECT_FALSE(FromMessage(message).ok());
  message = ToMessage(SmallMap(), "map");
  message.ground_triangles[0] = 3;  // there are vertices 0 to 2
  EXPECT_FALSE(FromMessage(message).ok());
}

}  // namespace
}  // namespace scenecalib
