#include "scenecalib/tracking/feature_detector.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

TEST(DetectFeatures, SpreadsCornersInsideTheMaskAwayFromLiveOnes) {
  const testing::Texture texture(5, 8.0, 40.0);
  const cv::Mat image = testing::Render(400, 300, texture);
  cv::Mat mask(300, 400, CV_8UC1, cv::Scalar(255));
  mask(cv::Rect(0, 0, 100, 300)).setTo(0);
  const std::vector<Eigen::Vector2d> live = {{200, 150}, {300, 100}};
  DetectionOptions options;
  options.max_features = 200;
  const auto features = DetectFeatures(image, mask, live, options);
  EXPECT_GT(features.size(), 120U);
  EXPECT_LE(features.size(), 198U);
  for (std::size_t i = 0; i < features.size(); ++i) {
    EXPECT_GE(features[i].x(), 100);
    for (const auto& other : live) EXPECT_GE((features[i] - other).norm(), options.min_distance_px);
    for (std::size_t k = 0; k < i; ++k) {
      EXPECT_GE((features[i] - features[k]).norm(), options.min_distance_px);
    }
  }
}

TEST(DetectFeatures, FindsNothingInAFlatImageOrWhenFull) {
  const cv::Mat mask(300, 400, CV_8UC1, cv::Scalar(255));
  DetectionOptions options;
  EXPECT_TRUE(
      DetectFeatures(cv::Mat(300, 400, CV_8UC1, cv::Scalar(99)), mask, {}, options).empty());
  options.max_features = 50;
  const testing::Texture texture(5, 8.0, 40.0);
  const cv::Mat image = testing::Render(400, 300, texture);
  EXPECT_TRUE(
      DetectFeatures(image, mask, std::vector<Eigen::Vector2d>(50, {10, 10}), options).empty());
}

TEST(DetectFeatures, PutsFewIntoABucketOfSmallShare) {
  const testing::Texture texture(5, 8.0, 40.0);
  const cv::Mat image = testing::Render(384, 256, texture);
  const cv::Mat mask(256, 384, CV_8UC1, cv::Scalar(255));
  DetectionOptions options;
  options.max_features = 400;
  const BucketGrid buckets(image.size(), options.bucket_px);
  ASSERT_EQ(buckets.size(), 24U);
  std::vector<double> share(buckets.size(), 1.0);
  const std::size_t scarce = buckets.At(100, 100);
  share[scarce] = 0.02;
  const auto count = [&](const std::vector<Eigen::Vector2d>& features) {
    return std::count_if(features.begin(), features.end(), [&](const Eigen::Vector2d& pixel) {
      return buckets.At(static_cast<int>(pixel.x()), static_cast<int>(pixel.y())) == scarce;
    });
  };
  EXPECT_GT(count(DetectFeatures(image, mask, {}, options)), 8);
  EXPECT_LE(count(DetectFeatures(image, mask, {}, options, share)), 3);
}

}  // namespace
}  // namespace scenecalib
