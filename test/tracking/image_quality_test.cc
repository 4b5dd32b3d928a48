#include "scenecalib/tracking/image_quality.h"

#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>

#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

using testing::Render;
using testing::Texture;

/// Deviation of an even distribution over one grey level, which rounding adds to every image.
constexpr double kRoundingLevels = 0.29;

TEST(ImageQuality, FindsTheNoiseUnderASmoothTexture) {
  const Texture texture(3, 30.0, 200.0);
  for (const double noise : {1.0, 2.0, 5.0}) {
    const cv::Mat image = Render(
        400, 300, [&](double x, double y) { return texture(x, y); }, noise, 7);
    const ImageQuality quality = MeasureImageQuality(image, cv::Mat());
    EXPECT_NEAR(quality.noise_levels, std::hypot(noise, kRoundingLevels), 0.1 * noise + 0.05);
  }
}

TEST(ImageQuality, EdgesAreNotNoise) {
  const cv::Mat image =
      Render(400, 300, [](double x, double y) { return x + 0.3 * y < 150 ? 40.0 : 200.0; });
  EXPECT_LT(MeasureImageQuality(image, cv::Mat()).noise_levels, 0.01);
}

TEST(ChangedShare, IsOfTheTilesThatShowSomethingElse) {
  const Texture texture(3, 8.0, 30.0);
  const auto shifted = [&](double by_px, double noise, std::uint64_t seed) {
    return Render(
        400, 300, [&](double x, double y) { return texture(x + by_px, y); }, noise, seed);
  };
  const cv::Mat image = shifted(0.0, 2.0, 1);
  EXPECT_LT(ChangedShare(image, shifted(0.0, 2.0, 2), 2.0), 0.02) << "noise";
  EXPECT_LT(ChangedShare(image, shifted(0.1, 2.0, 2), 2.0), 0.02);
  EXPECT_GT(ChangedShare(image, shifted(1.5, 2.0, 2), 2.0), 0.95);
  cv::Mat brighter;
  image.convertTo(brighter, -1, 1.0, 15.0);
  EXPECT_LT(ChangedShare(image, brighter, 2.0), 0.02);
  cv::Mat half = image.clone();
  shifted(9.0, 2.0, 2).colRange(0, 200).copyTo(half.colRange(0, 200));
  EXPECT_NEAR(ChangedShare(image, half, 2.0), 0.5, 0.05);
  const cv::Mat sky = Render(
      400, 300, [](double, double) { return 200.0; }, 2.0, 3);
  const cv::Mat sky_later = Render(
      400, 300, [](double, double) { return 190.0; }, 2.0, 4);
  EXPECT_EQ(ChangedShare(sky, sky_later, 2.0), 0.0);
}

TEST(ImageQuality, MeanAndContrastAreTheMaskedPixels) {
  cv::Mat image(300, 400, CV_8UC1, cv::Scalar(0));
  image.colRange(200, 400).setTo(100);
  cv::Mat mask(300, 400, CV_8UC1, cv::Scalar(0));
  mask.colRange(200, 400).setTo(255);
  const ImageQuality right = MeasureImageQuality(image, mask);
  EXPECT_DOUBLE_EQ(right.mean, 100.0);
  EXPECT_DOUBLE_EQ(right.contrast, 0.0);
  const ImageQuality all = MeasureImageQuality(image, cv::Mat());
  EXPECT_NEAR(all.mean, 50.0, 1.5);
  EXPECT_NEAR(all.contrast, 50.0, 0.1);
  EXPECT_EQ(MeasureImageQuality(image, cv::Mat(300, 400, CV_8UC1, cv::Scalar(0))).mean, 0.0);
}

TEST(ImageQuality, BlurLowersSharpnessAndNoiseDoesNotRaiseIt) {
  const Texture texture(3, 6.0, 30.0);
  const auto at = [&](double x, double y) { return texture(x, y); };
  const cv::Mat sharp = Render(400, 300, at);
  const cv::Mat noisy = Render(
      400, 300, [](double, double) { return 128.0; }, 4.0, 7);
  cv::Mat blurred;
  cv::GaussianBlur(sharp, blurred, {0, 0}, 3.0);
  const double sharpness = MeasureImageQuality(sharp, cv::Mat()).sharpness;
  EXPECT_LT(MeasureImageQuality(blurred, cv::Mat()).sharpness, 0.8 * sharpness);
  EXPECT_LT(MeasureImageQuality(noisy, cv::Mat()).sharpness, 0.1 * sharpness);
}

TEST(RelativeSharpness, NamesTheBlurredAmongItsNeighbours) {
  const Texture texture(3, 6.0, 30.0);
  std::map<Timestamp, cv::Mat> images;
  for (int i = 0; i < 12; ++i) {
    images[i] = Render(
        200, 150, [&](double x, double y) { return texture(x + 5.0 * i, y); }, 1.0, i);
  }
  cv::blur(images[5], images[5], {9, 1});
  for (const auto& [stamp_ns, relative] : RelativeSharpness(images)) {
    if (stamp_ns == 5) {
      EXPECT_LT(relative, 0.75);
    } else {
      EXPECT_NEAR(relative, 1.0, 0.1);
    }
  }
}

TEST(RelativeSharpness, SaysNothingWhereThereIsNothingToSee) {
  EXPECT_TRUE(RelativeSharpness({}).empty());
  const cv::Mat black(100, 100, CV_8UC1, cv::Scalar(0));
  for (const auto& [stamp_ns, relative] : RelativeSharpness({{1, black}, {2, black}})) {
    EXPECT_EQ(relative, 1.0);
  }
}

}  // namespace
}  // namespace scenecalib
