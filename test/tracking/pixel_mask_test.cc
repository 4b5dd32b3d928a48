#include "../../src/tracking/pixel_mask.h"

#include <gtest/gtest.h>

namespace scenecalib {
namespace {

TEST(Disc, FillsWhatACircleFills) {
  for (const int radius_px : {0, 1, 2, 4, 7, 19}) {
    const Disc disc(radius_px);
    for (const cv::Point& center : {cv::Point(30, 25), cv::Point(0, 0), cv::Point(58, 39),
                                    cv::Point(-3, 20), cv::Point(70, 55), cv::Point(200, 20)}) {
      cv::Mat circle(40, 60, CV_8UC1, cv::Scalar(9));
      cv::Mat filled = circle.clone();
      cv::circle(circle, center, radius_px, cv::Scalar(200), cv::FILLED);
      disc.Fill(center, 200, &filled);
      EXPECT_EQ(cv::norm(circle, filled, cv::NORM_INF), 0.0) << radius_px << " at " << center;
    }
  }
}

TEST(IsSet, IsFalseOutside) {
  cv::Mat mask(4, 6, CV_8UC1, cv::Scalar(1));
  mask.at<uchar>(1, 2) = 0;
  EXPECT_TRUE(IsSet(mask, {5.4, 3.4}));
  EXPECT_FALSE(IsSet(mask, {2.3, 0.8}));
  EXPECT_FALSE(IsSet(mask, {5.6, 3.0}));
  EXPECT_FALSE(IsSet(mask, {1.0, -0.6}));
}

}  // namespace
}  // namespace scenecalib
