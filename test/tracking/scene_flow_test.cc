#include "scenecalib/tracking/scene_flow.h"

#include <gtest/gtest.h>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/so3.h"
#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

using testing::HitPlanes;
using testing::MakeFisheye;
using testing::Texture;
using testing::TexturedPlane;

/// A fisheye that drives over a road, and the pixels of points on it before and after.
struct Drive {
  CameraModelPtr model = MakeFisheye(800, 600, 230.0);
  std::vector<TexturedPlane> road = {
      {{0, 1.5, 0}, Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitZ(), Texture(1, 0.3, 2.0)}};
  Rigid3 map_from_first;
  Rigid3 map_from_second{ExpSo3({0.01, 0.03, 0.0}), {0.05, 0.0, 0.9}};

  std::optional<Eigen::Vector2d> Transfer(const Eigen::Vector2d& pixel) const {
    return Transfer(pixel, map_from_second);
  }

  /// From the first camera to another.
  std::optional<Eigen::Vector2d> Transfer(const Eigen::Vector2d& pixel,
                                          const Rigid3& map_from_other) const {
    const auto hit = HitPlanes(road, *model, map_from_first, pixel);
    if (!hit) return std::nullopt;
    return model->Project(map_from_other.Inverse() * hit->point_in_map_m);
  }

  /// Only the distant part of the road could be followed.
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> FarFeatures(double noise_px) const {
    Random random(4);
    std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> pixels;
    while (pixels.size() < 150) {
      const Eigen::Vector2d pixel(random.Uniform(150, 650), random.Uniform(345, 420));
      const auto after = Transfer(pixel);
      if (!after) continue;
      pixels.emplace_back(
          pixel, *after + noise_px * Eigen::Vector2d(random.Gaussian(), random.Gaussian()));
    }
    return pixels;
  }
};

TEST(SceneFlow, CarriesARoadSeenFarAwayToWhereItIsNear) {
  const Drive drive;
  const auto flow = SceneFlow::Estimate(*drive.model, drive.FarFeatures(0.05), 1.0, {});
  ASSERT_TRUE(flow);
  for (const Eigen::Vector2d& pixel :
       {Eigen::Vector2d(400, 470), Eigen::Vector2d(300, 480), Eigen::Vector2d(520, 460)}) {
    const auto truth = drive.Transfer(pixel);
    ASSERT_TRUE(truth);
    ASSERT_GT((*truth - pixel).norm(), 40.0) << "a motion that searching would not find";
    const auto warp = flow->Predict(pixel);
    ASSERT_TRUE(warp);
    // Near enough for the registration that follows.
    EXPECT_LT((warp->center_px - *truth).norm(), 8.0);
    const Eigen::Vector2d step(3.0, 3.0);
    const Eigen::Vector2d stretched =
        (*drive.Transfer(pixel + step) - *drive.Transfer(pixel - step)) / 2.0;
    EXPECT_LT((warp->affine * step - stretched).norm(), 1.5);
  }
}

TEST(SceneFlow, PredictsNothingOutOfTheImage) {
  const Drive drive;
  const auto flow = SceneFlow::Estimate(*drive.model, drive.FarFeatures(0.05), 1.0, {});
  ASSERT_TRUE(flow);
  EXPECT_FALSE(flow->Predict({400, 597}));
}

TEST(SceneFlow, ContinuesAFeatureAsTheCameraMoves) {
  const Drive drive;
  const auto flow = SceneFlow::Estimate(*drive.model, drive.FarFeatures(0.05), 1.0, {});
  ASSERT_TRUE(flow);
  for (const double ratio : {1.0, 1.5}) {
    const Rigid3 second_from_third{ExpSo3(ratio * Eigen::Vector3d(0.01, 0.03, 0.0)),
                                   ratio * drive.map_from_second.translation};
    const Rigid3 map_from_third = drive.map_from_second * second_from_third;
    for (const Eigen::Vector2d& before : {Eigen::Vector2d(420, 400), Eigen::Vector2d(300, 400)}) {
      const Eigen::Vector2d after = *drive.Transfer(before);
      const Eigen::Vector2d truth = *drive.Transfer(before, map_from_third);
      const auto next = flow->Continue(before, after, ratio);
      ASSERT_TRUE(next);
      EXPECT_LT((*next - truth).norm(), ratio == 1.0 ? 1.0 : 4.0);
      EXPECT_GT((after + ratio * (after - before) - truth).norm(), 8.0)
          << "repeating the step would do as well";
    }
  }
}

TEST(SceneFlow, DoesNotContinueWhatMovesByItself) {
  const Drive drive;
  const auto flow = SceneFlow::Estimate(*drive.model, drive.FarFeatures(0.05), 1.0, {});
  ASSERT_TRUE(flow);
  const Eigen::Vector2d before(300, 420);
  const Eigen::Vector2d after = *drive.Transfer(before);
  ASSERT_TRUE(flow->Continue(before, after, 1.0));
  const Eigen::Vector2d step = after - before;
  const Eigen::Vector2d across = Eigen::Vector2d(-step.y(), step.x()).normalized();
  EXPECT_FALSE(flow->Continue(before, after + 6.0 * across, 1.0));
  EXPECT_FALSE(flow->Continue(before, before - step, 1.0)) << "it would be behind the camera";
}

TEST(SceneFlow, NeedsMotionAndEnoughFeatures) {
  const Drive drive;
  auto pixels = drive.FarFeatures(0.05);
  for (auto& [before, after] : pixels) after = before;
  EXPECT_FALSE(SceneFlow::Estimate(*drive.model, pixels, 1.0, {})) << "standing still";
  pixels = drive.FarFeatures(0.05);
  pixels.resize(20);
  EXPECT_FALSE(SceneFlow::Estimate(*drive.model, pixels, 1.0, {}));
}

}  // namespace
}  // namespace scenecalib
