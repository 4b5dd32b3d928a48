#include "../../src/calibration/patch_support.h"

#include <gtest/gtest.h>

#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

constexpr double kFocal_px = 500.0;
constexpr double kWallRange_m = 10.0;
constexpr int kRadius_px = 10;

/// A wall across the optical axis, of discs, with what lies beyond `step_x_m` recessed.
SceneMap WallWithStep(double step_x_m, double recess_m) {
  SceneMap map;
  Surfel surfel;
  surfel.normal = -Eigen::Vector3f::UnitZ();
  surfel.radius_m = 0.08F;
  surfel.scale_m = 0.1F;
  for (double x = -2.0; x <= 2.0; x += 0.05) {
    for (double y = -1.0; y <= 1.0; y += 0.05) {
      // Discs end at the step: none reaches over it.
      if (std::abs(x - step_x_m) < surfel.radius_m) continue;
      const double z = kWallRange_m + (x > step_x_m ? recess_m : 0.0);
      surfel.center_m = Eigen::Vector3d(x, y, z).cast<float>();
      map.surfels.push_back(surfel);
    }
  }
  return map;
}

CameraModelPtr Camera() {
  CameraIntrinsics intrinsics;
  intrinsics.model = "plumb_bob";
  intrinsics.width_px = 960;
  intrinsics.height_px = 600;
  intrinsics.focal_px = {kFocal_px, kFocal_px};
  intrinsics.principal_point_px = {480.0, 300.0};
  intrinsics.distortion = {0, 0, 0, 0, 0};
  return CreateCameraModel(intrinsics).value();
}

PatchOnSurface PatchAt(const Eigen::Vector2d& pixel) {
  PatchOnSurface patch;
  patch.pixel = pixel;
  patch.plane.point_in_map_m = {0.0, 0.0, kWallRange_m};
  patch.plane.normal_in_map = -Eigen::Vector3d::UnitZ();
  return patch;
}

std::vector<int> RadiiAt(const SceneMap& map, const Eigen::Vector2d& pixel) {
  return RadiiOnPlane({PatchAt(pixel)}, *Camera(), *RayCaster::Create(map), kRadius_px);
}

TEST(RadiiOnPlane, AWallAloneGivesTheWholePatch) {
  EXPECT_EQ(RadiiAt(WallWithStep(5.0, 0.0), {480.0, 300.0}), std::vector<int>{kRadius_px});
}

TEST(RadiiOnPlane, APatchEndsBeforeARecess) {
  // 0.16 m at 10 m are 8 px to the right of the centre.
  const std::vector<int> radii = RadiiAt(WallWithStep(0.16, 0.1), {480.0, 300.0});
  ASSERT_EQ(radii.size(), 1U);
  EXPECT_GE(radii[0], 4);
  EXPECT_LT(radii[0], 8);
}

TEST(RadiiOnPlane, ARecessShallowerThanTheMapsErrorsDoesNotCount) {
  SceneMap map = WallWithStep(0.16, 0.01);
  // The strip without discs at the step is a hole, so it is filled.
  Surfel filling = map.surfels.front();
  for (double y = -1.0; y <= 1.0; y += 0.05) {
    filling.center_m = Eigen::Vector3d(0.16, y, kWallRange_m).cast<float>();
    filling.radius_m = 0.15F;
    map.surfels.push_back(filling);
  }
  EXPECT_EQ(RadiiAt(map, {480.0, 300.0}), std::vector<int>{kRadius_px});
}

TEST(RadiiOnPlane, NothingIsLeftAtTheVeryEdgeOrWhereTheMapShowsNothing) {
  EXPECT_EQ(RadiiAt(WallWithStep(0.02, 0.1), {480.0, 300.0}), std::vector<int>{0});
  EXPECT_EQ(RadiiAt(WallWithStep(5.0, 0.0), {20.0, 300.0}), std::vector<int>{0});
}

TEST(DropTracksAtEdges, EmptiesThemAndLeavesTheOthers) {
  std::vector<Track> tracks(4);
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    tracks[i].id = static_cast<std::int64_t>(i);
    tracks[i].observations.resize(3 + i);
  }
  // The recess begins 1 px right of the first patch's centre, 51 px right of the second's.
  const TiedTracks tied =
      DropTracksAtEdges({1, 3}, {PatchAt({480.0, 300.0}), PatchAt({430.0, 300.0})}, *Camera(),
                        *RayCaster::Create(WallWithStep(0.02, 0.1)), kRadius_px, &tracks);
  EXPECT_EQ(tied.indices, std::vector<int>{3});
  ASSERT_EQ(tied.tracks.size(), 1U);
  EXPECT_EQ(tied.tracks[0].id, 3);
  ASSERT_EQ(tied.planes.size(), 1U);
  EXPECT_EQ(tied.planes[0].radius_px, kRadius_px);
  EXPECT_TRUE(tracks[1].observations.empty());
  // Neither the one on the wall nor those without a plane lose anything.
  EXPECT_EQ(tracks[0].observations.size(), 3U);
  EXPECT_EQ(tracks[2].observations.size(), 5U);
  EXPECT_EQ(tracks[3].observations.size(), 6U);
}

}  // namespace
}  // namespace scenecalib
