#include "../../src/tracking/feature_prediction.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>

#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

constexpr Timestamp kPeriod_ns = 100000000;
constexpr PredictionTimes kTimes{1 * kPeriod_ns, 2 * kPeriod_ns, 3 * kPeriod_ns};

/// A track that was seen at these places, the last one in the last image.
ActiveTrack SeenAt(const std::vector<Eigen::Vector2d>& pixels) {
  cv::Mat1b image(60, 60);
  cv::RNG random(7);
  random.fill(image, cv::RNG::UNIFORM, 0, 255);
  ActiveTrack track{
      {},
      *PatchTemplate::Create(image, {30.0, 30.0}, 7, WarpFreedom::kAffine, PatchReading::kBilinear),
      Eigen::Matrix2d::Identity(),
      {},
      0,
      false};
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const auto age = static_cast<Timestamp>(pixels.size() - 1 - i);
    track.track.observations.push_back(
        {kTimes.previous_ns - age * kPeriod_ns, pixels[i], Eigen::Matrix2d::Identity()});
  }
  track.place = track.track.observations.back();
  return track;
}

TEST(PredictFeatures, RepeatsTheLastStepWithItsGrowth) {
  // 5 px, then 6 px: 7.2 px come next.
  const auto predicted =
      PredictFeatures({SeenAt({{100.0, 50.0}, {105.0, 50.0}, {111.0, 50.0}})}, nullptr, kTimes);
  ASSERT_EQ(predicted.size(), 1U);
  EXPECT_NEAR(predicted[0].pixel.x(), 111.0 + 7.2, 1e-9);
  EXPECT_NEAR(predicted[0].pixel.y(), 50.0, 1e-9);
}

TEST(PredictFeatures, StepsOfTheSizeOfNoiseAreNotGrown) {
  const auto predicted =
      PredictFeatures({SeenAt({{100.0, 50.0}, {101.0, 50.0}, {103.0, 50.0}})}, nullptr, kTimes);
  EXPECT_NEAR(predicted[0].pixel.x(), 105.0, 1e-9);
}

TEST(PredictFeatures, AnImageThatIsLateIsFurtherOff) {
  PredictionTimes times = kTimes;
  times.now_ns += kPeriod_ns / 2;
  const auto predicted = PredictFeatures({SeenAt({{100.0, 50.0}, {104.0, 50.0}})}, nullptr, times);
  EXPECT_NEAR(predicted[0].pixel.x(), 104.0 + 1.5 * 4.0, 1e-9);
}

TEST(PredictFeatures, AFeatureWithoutHistoryBorrowsItsNeighboursMotion) {
  std::vector<ActiveTrack> active;
  for (int i = 0; i < 5; ++i) {  // near by
    active.push_back(SeenAt({{100.0 + i, 50.0}, {103.0 + i, 51.0}}));
  }
  for (int i = 0; i < 5; ++i) {  // far off
    active.push_back(SeenAt({{500.0 + i, 50.0}, {480.0 + i, 50.0}}));
  }
  active.push_back(SeenAt({{110.0, 60.0}}));
  const auto predicted = PredictFeatures(active, nullptr, kTimes);
  EXPECT_NEAR(predicted.back().pixel.x(), 113.0, 1e-9);
  EXPECT_NEAR(predicted.back().pixel.y(), 61.0, 1e-9);
  // With nobody near enough known it stays.
  EXPECT_NEAR(PredictFeatures({active.back()}, nullptr, kTimes)[0].pixel.x(), 110.0, 1e-9);
}

TEST(PredictFeatures, AFeatureWithoutHistoryFollowsTheSceneFlow) {
  // Ahead over a road: what is near and new moves unlike all that is followed far ahead.
  const CameraModelPtr model = testing::MakeFisheye(800, 600, 230.0);
  const Eigen::Vector3d ahead_m(0.05, 0.0, 0.9);
  const auto after = [&](const Eigen::Vector2d& pixel) {
    const Eigen::Vector3d ray = *model->Unproject(pixel);
    return *model->Project(1.5 / ray.y() * ray - ahead_m);
  };
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> followed;
  std::vector<ActiveTrack> active;
  for (int x = 150; x < 650; x += 25) {
    for (int y = 345; y < 420; y += 10) {
      followed.emplace_back(Eigen::Vector2d(x, y), after({x, y}));
      active.push_back(SeenAt({followed.back().first, followed.back().second}));
    }
  }
  const auto flow = SceneFlow::Estimate(*model, followed, 1.0, {});
  ASSERT_TRUE(flow);
  const Eigen::Vector2d near_px(400, 470);
  active.push_back(SeenAt({near_px}));
  const Eigen::Vector2d truth = after(near_px);
  ASSERT_GT((truth - near_px).norm(), 40.0);
  const FeaturePrediction predicted = PredictFeatures(active, &*flow, kTimes).back();
  EXPECT_LT((predicted.pixel - truth).norm(), 8.0);
  EXPECT_GT(predicted.affine_from_first.determinant(), 1.2) << "it comes nearer";
  const FeaturePrediction borrowed = PredictFeatures(active, nullptr, kTimes).back();
  EXPECT_GT((borrowed.pixel - truth).norm(), 20.0) << "what its neighbours do is no help";
  // An image that comes late is further off.
  PredictionTimes late = kTimes;
  late.now_ns += kPeriod_ns / 2;
  EXPECT_LT((PredictFeatures(active, &*flow, late).back().pixel - near_px -
             1.5 * (predicted.pixel - near_px))
                .norm(),
            1e-9);
}

TEST(PredictFeatures, AFollowedFeatureGoesOnAsTheSceneMoves) {
  const CameraModelPtr model = testing::MakeFisheye(800, 600, 230.0);
  const auto after = [&](const Eigen::Vector2d& pixel) {
    const Eigen::Vector3d ray = *model->Unproject(pixel);
    return *model->Project(1.5 / ray.y() * ray - Eigen::Vector3d(0.05, 0.0, 0.9));
  };
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> followed;
  for (int x = 150; x < 650; x += 25) {
    for (int y = 345; y < 420; y += 10) {
      followed.emplace_back(Eigen::Vector2d(x, y), after({x, y}));
    }
  }
  const auto flow = SceneFlow::Estimate(*model, followed, 1.0, {});
  ASSERT_TRUE(flow);
  const Eigen::Vector2d first(430, 425);
  const Eigen::Vector2d second = after(first);
  const Eigen::Vector2d truth = after(second);
  const std::vector<ActiveTrack> active = {
      SeenAt({first, second}), SeenAt({{200.0, 200.0}, {200.0, 212.0}})};  // the other one: a bird
  const auto predicted = PredictFeatures(active, &*flow, kTimes);
  EXPECT_LT((predicted[0].pixel - truth).norm(), 1.0);
  EXPECT_GT((PredictFeatures(active, nullptr, kTimes)[0].pixel - truth).norm(), 10.0);
  EXPECT_NEAR(predicted[1].pixel.x(), 200.0, 1e-9) << "as it went before";
  EXPECT_NEAR(predicted[1].pixel.y(), 224.0, 1e-9);
}

TEST(PredictFeatures, WhatTheLastImageDidNotShowStays) {
  ActiveTrack missed = SeenAt({{100.0, 50.0}, {105.0, 50.0}});
  missed.num_missed = 1;
  missed.place.pixel = {107.0, 50.0};
  EXPECT_NEAR(PredictFeatures({missed}, nullptr, kTimes)[0].pixel.x(), 107.0, 1e-9);
}

}  // namespace
}  // namespace scenecalib
