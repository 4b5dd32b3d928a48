#include "scenecalib/tracking/relative_motion.h"

#include <gtest/gtest.h>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/so3.h"
#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

using testing::MakeFisheye;

constexpr double kNoisePx = 0.1;

struct Scene {
  std::vector<RayPair> pairs;
  Rigid3 second_from_first;
};

/// Pairs of pixels of one camera that sees random points; `on_plane` puts them all on a road.
Scene MakeScene(const CameraModel& model, const Rigid3& second_from_first, int num_pairs,
                int num_moving, bool on_plane, std::uint64_t seed) {
  Random random(seed);
  Scene scene;
  scene.second_from_first = second_from_first;
  while (static_cast<int>(scene.pairs.size()) < num_pairs) {
    const Eigen::Vector2d pixel(random.Uniform(0.0, model.width_px() - 1.0),
                                random.Uniform(0.0, model.height_px() - 1.0));
    const auto ray = model.Unproject(pixel);
    if (!ray) continue;
    double range = random.Uniform(3.0, 30.0);
    if (on_plane) {
      if (ray->y() < 0.1) continue;
      range = 1.5 / ray->y();
    }
    Eigen::Vector3d moved = second_from_first * (range * *ray);
    if (static_cast<int>(scene.pairs.size()) < num_moving) {
      moved += Eigen::Vector3d(0.0, random.Uniform(0.05, 0.1) * range, 0.0);
    }
    auto second_px = model.Project(moved);
    if (!second_px) continue;
    *second_px += kNoisePx * Eigen::Vector2d(random.Gaussian(), random.Gaussian());
    UnprojectionJacobians first, second;
    const auto first_ray = model.Unproject(pixel, &first);
    const auto second_ray = model.Unproject(*second_px, &second);
    if (!first_ray || !second_ray) continue;
    scene.pairs.push_back({*first_ray, *second_ray, first.ray_by_pixel, second.ray_by_pixel});
  }
  return scene;
}

double DirectionErrorRad(const RelativeMotion& motion, const Rigid3& truth) {
  // The constraint does not know the direction's sign.
  return std::asin(std::min(1.0, motion.direction.cross(truth.translation.normalized()).norm()));
}

TEST(EstimateRelativeMotion, RecoversTheMotionOfAFisheyeThatSeesBehindItself) {
  const auto model = MakeFisheye(800, 800, 230.0);
  ASSERT_GT(model->max_theta_rad(), M_PI / 2);
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Random random(seed);
    const Eigen::Vector3d direction =
        Eigen::Vector3d(random.Gaussian(), random.Gaussian(), random.Gaussian()).normalized();
    const Rigid3 truth(ExpSo3({0.05, -0.15, 0.03}), direction);
    const Scene scene = MakeScene(*model, truth, 300, 60, false, seed);
    const auto motion = EstimateRelativeMotion(scene.pairs, {});
    ASSERT_TRUE(motion) << "seed " << seed;
    EXPECT_LT(RotationAngle(motion->second_from_first, truth.rotation), 1e-3) << "seed " << seed;
    EXPECT_LT(DirectionErrorRad(*motion, truth), 0.01) << "seed " << seed;
    EXPECT_LT(motion->inlier_rms_px, 2.0 * kNoisePx);
    for (int i = 60; i < 300; ++i) EXPECT_TRUE(motion->inlier[i]) << "pair " << i;
  }
}

TEST(EstimateRelativeMotion, WorksWhenEverythingSeenLiesOnOnePlane) {
  const auto model = MakeFisheye(800, 600, 230.0);
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    const Rigid3 truth(ExpSo3({0.0, 0.04, 0.0}), {0.1, 0.0, -1.0});
    const Scene scene = MakeScene(*model, truth, 300, 0, true, seed);
    const auto motion = EstimateRelativeMotion(scene.pairs, {});
    ASSERT_TRUE(motion);
    EXPECT_GT(motion->num_inliers, 290);
    EXPECT_LT(motion->inlier_rms_px, 2.0 * kNoisePx);
  }
}

TEST(EstimateRelativeMotion, FlagsPointsThatMoveAcrossTheEpipolarLines) {
  const auto model = MakeFisheye(800, 600, 300.0);
  const Rigid3 truth(ExpSo3({0.0, 0.02, 0.0}), {0.0, 0.0, -1.0});
  const Scene scene = MakeScene(*model, truth, 300, 90, false, 5);
  const auto motion = EstimateRelativeMotion(scene.pairs, {});
  ASSERT_TRUE(motion);
  int num_flagged = 0;
  for (int i = 0; i < 90; ++i) num_flagged += motion->inlier[i] ? 0 : 1;
  EXPECT_GT(num_flagged, 75) << "a vertical motion is an epipolar one only above and below";
}

TEST(EstimateRelativeMotion, AcceptsEveryPairWhenTheCameraOnlyTurnsOrStands) {
  const auto model = MakeFisheye(800, 600, 300.0);
  for (const Eigen::Vector3d& turn : {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(0.01, 0.2, 0)}) {
    const Scene scene = MakeScene(*model, Rigid3(ExpSo3(turn), {0, 0, 0}), 200, 0, false, 7);
    const auto motion = EstimateRelativeMotion(scene.pairs, {});
    ASSERT_TRUE(motion);
    EXPECT_EQ(motion->num_inliers, 200);
    EXPECT_LT(RotationAngle(motion->second_from_first, scene.second_from_first.rotation), 2e-3);
  }
}

TEST(EstimateRelativeMotion, GivesTheSameAnswerForTheSameSeed) {
  const auto model = MakeFisheye(800, 600, 300.0);
  const Scene scene =
      MakeScene(*model, Rigid3(ExpSo3({0, 0.02, 0}), {0, 0, -1}), 100, 20, false, 5);
  const auto a = EstimateRelativeMotion(scene.pairs, {});
  const auto b = EstimateRelativeMotion(scene.pairs, {});
  ASSERT_TRUE(a && b);
  EXPECT_EQ(a->direction, b->direction);
  EXPECT_EQ(a->inlier, b->inlier);
}

TEST(EstimateRelativeMotion, SaysNothingFromTooFewPairs) {
  const auto model = MakeFisheye(800, 600, 300.0);
  Scene scene = MakeScene(*model, Rigid3(ExpSo3({0, 0, 0}), {0, 0, -1}), 11, 0, false, 5);
  EXPECT_FALSE(EstimateRelativeMotion(scene.pairs, {}));
}

}  // namespace
}  // namespace scenecalib
