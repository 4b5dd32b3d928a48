#include "../../src/calibration/warped_sampling.h"

#include <gtest/gtest.h>

namespace scenecalib {
namespace {

/// Grey values that grow by 2 a column and 3 a row.
cv::Mat1b Ramp() {
  cv::Mat1b image(20, 30);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) image(y, x) = static_cast<uchar>(2 * x + 3 * y);
  }
  return image;
}

cv::Mat2f MapOf(const cv::Size& size, const cv::Vec2f& start, float step) {
  cv::Mat2f map(size);
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      map(y, x) = start + step * cv::Vec2f(static_cast<float>(x), static_cast<float>(y));
    }
  }
  return map;
}

TEST(SampleAt, InterpolatesBetweenPixels) {
  const cv::Mat1b sampled = SampleAt(Ramp(), MapOf({5, 4}, {3.5F, 2.0F}, 1.0F), false);
  ASSERT_EQ(sampled.size(), cv::Size(5, 4));
  EXPECT_EQ(sampled(0, 0), 13);  // 2 * 3.5 + 3 * 2
  EXPECT_EQ(sampled(3, 4), 13 + 2 * 4 + 3 * 3);
}

TEST(SampleAt, BeyondTheBorderIsWhatTheBorderHas) {
  const cv::Mat1b image = Ramp();
  EXPECT_EQ(SampleAt(image, MapOf({1, 1}, {-7.0F, -9.0F}, 1.0F), false)(0, 0), image(0, 0));
  EXPECT_EQ(SampleAt(image, MapOf({1, 1}, {90.0F, 90.0F}, 1.0F), false)(0, 0), image(19, 29));
}

TEST(SampleAt, AFinerImageIsAveragedOverThePixelOfTheGrid) {
  // Stripes a pixel wide, read with a grid of two pixels.
  cv::Mat1b stripes(40, 40);
  for (int y = 0; y < 40; ++y) {
    for (int x = 0; x < 40; ++x) stripes(y, x) = x % 2 == 0 ? 0 : 200;
  }
  const cv::Mat2f map = MapOf({10, 10}, {10.0F, 10.0F}, 2.0F);
  const cv::Mat1b once = SampleAt(stripes, map, false);
  const cv::Mat1b averaged = SampleAt(stripes, map, true);
  for (int y = 1; y < 9; ++y) {
    for (int x = 1; x < 9; ++x) {
      EXPECT_EQ(once(y, x), 0);
      EXPECT_NEAR(averaged(y, x), 100, 1);
    }
  }
}

TEST(SampleAt, AveragingLeavesARampAsItIs) {
  const cv::Mat2f map = MapOf({6, 6}, {4.0F, 4.0F}, 2.0F);
  const cv::Mat1b once = SampleAt(Ramp(), map, false);
  const cv::Mat1b averaged = SampleAt(Ramp(), map, true);
  for (int y = 1; y < 5; ++y) {
    for (int x = 1; x < 5; ++x) EXPECT_NEAR(averaged(y, x), once(y, x), 1);
  }
}

}  // namespace
}  // namespace scenecalib
