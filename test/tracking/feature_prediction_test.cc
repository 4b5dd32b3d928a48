#include "../../src/tracking/feature_prediction.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>

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

TEST(PredictFeatures, WhatTheLastImageDidNotShowStays) {
  ActiveTrack missed = SeenAt({{100.0, 50.0}, {105.0, 50.0}});
  missed.num_missed = 1;
  missed.place.pixel = {107.0, 50.0};
  EXPECT_NEAR(PredictFeatures({missed}, nullptr, kTimes)[0].pixel.x(), 107.0, 1e-9);
}

}  // namespace
}  // namespace scenecalib
