#include "../../src/calibration/patch_correlation.h"

#include <gtest/gtest.h>

#include <cmath>

namespace scenecalib {
namespace {

constexpr int kPatch = 33;
constexpr int kSearch = 8;

double Blotches(double x, double y) {
  return 128.0 + 50.0 * std::sin(0.45 * x + 0.8 * std::sin(0.21 * y)) +
         45.0 * std::sin(0.39 * y - 0.9 * std::sin(0.17 * x));
}

cv::Mat1b Paint(int edge, double x0, double y0, double gain) {
  cv::Mat1b image(edge, edge);
  for (int y = 0; y < edge; ++y) {
    for (int x = 0; x < edge; ++x) {
      image(y, x) = cv::saturate_cast<uchar>(gain * Blotches(x - x0, y - y0));
    }
  }
  return image;
}

cv::Mat1b FullMask() { return cv::Mat1b(kPatch, kPatch, uchar{255}); }

TEST(PatchCorrelation, FindsAShiftToAFractionOfAPixelWhateverTheExposure) {
  const double shift_x = 2.3;
  const double shift_y = -3.6;
  const auto peak =
      Correlate(Paint(kPatch, 0.0, 0.0, 1.0), FullMask(),
                Paint(kPatch + 2 * kSearch, kSearch + shift_x, kSearch + shift_y, 0.5));
  ASSERT_TRUE(peak);
  EXPECT_GT(peak->ncc, 0.97);
  EXPECT_NEAR(peak->shift_px.x(), shift_x, 0.3);
  EXPECT_NEAR(peak->shift_px.y(), shift_y, 0.3);
}

TEST(PatchCorrelation, PixelsOutsideTheMaskDoNotCount) {
  cv::Mat1b patch = Paint(kPatch, 0.0, 0.0, 1.0);
  cv::Mat1b mask = FullMask();
  const cv::Rect spoilt(0, 0, kPatch / 2, kPatch);
  patch(spoilt) = 255;
  const cv::Mat1b window = Paint(kPatch + 2 * kSearch, kSearch + 2.0, kSearch + 1.0, 1.0);
  const auto spoilt_peak = Correlate(patch, mask, window);
  mask(spoilt) = 0;
  const auto peak = Correlate(patch, mask, window);
  ASSERT_TRUE(peak);
  EXPECT_GT(peak->ncc, 0.97);
  EXPECT_NEAR(peak->shift_px.x(), 2.0, 0.3);
  EXPECT_NEAR(peak->shift_px.y(), 1.0, 0.3);
  EXPECT_TRUE(!spoilt_peak || spoilt_peak->ncc < peak->ncc - 0.1);
}

TEST(PatchCorrelation, APeakAtTheBorderIsNone) {
  EXPECT_FALSE(Correlate(Paint(kPatch, 0.0, 0.0, 1.0), FullMask(),
                         Paint(kPatch + 2 * kSearch, kSearch + 9.0, kSearch, 1.0)));
}

TEST(PatchCorrelation, NothingThatVariesIsNone) {
  EXPECT_FALSE(Correlate(cv::Mat1b(kPatch, kPatch, uchar{90}), FullMask(),
                         Paint(kPatch + 2 * kSearch, kSearch, kSearch, 1.0)));
  EXPECT_FALSE(Correlate(Paint(kPatch, 0.0, 0.0, 1.0), cv::Mat1b(kPatch, kPatch, uchar{0}),
                         Paint(kPatch + 2 * kSearch, kSearch, kSearch, 1.0)));
}

TEST(PatchCorrelation, AStripeHasAWidePeak) {
  cv::Mat1b stripe(kPatch + 2 * kSearch, kPatch + 2 * kSearch);
  for (int y = 0; y < stripe.rows; ++y) {
    for (int x = 0; x < stripe.cols; ++x) {
      stripe(y, x) = cv::saturate_cast<uchar>(128.0 + 100.0 * std::tanh(0.5 * (x - 24)));
    }
  }
  const cv::Rect middle(kSearch, kSearch, kPatch, kPatch);
  const auto stripe_peak = Correlate(stripe(middle), FullMask(), stripe);
  const auto blotch_peak = Correlate(Paint(kPatch, 0.0, 0.0, 1.0), FullMask(),
                                     Paint(kPatch + 2 * kSearch, kSearch, kSearch, 1.0));
  ASSERT_TRUE(blotch_peak);
  // Along the stripe every position is alike: the peak is at the border or wide.
  EXPECT_TRUE(!stripe_peak || stripe_peak->width_px > 1.3 * blotch_peak->width_px);
}

}  // namespace
}  // namespace scenecalib
