#include "scenecalib/tracking/noisy_images.h"

#include <gtest/gtest.h>

#include <cmath>

#include "scenecalib/base/options.h"
#include "scenecalib/base/random.h"
#include "scenecalib/tracking/pixel_reading.h"

namespace scenecalib {
namespace {

cv::Mat Noise(double sigma) {
  Random random(5);
  cv::Mat image(200, 200, CV_8UC1);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      image.at<uchar>(y, x) = cv::saturate_cast<uchar>(100.0 + sigma * random.Gaussian());
    }
  }
  return image;
}

/// Deviation of what is read smoothly on whole pixels.
double ReadDeviation(const cv::Mat& image) {
  double sum = 0.0;
  double square_sum = 0.0;
  int count = 0;
  for (int y = 10; y < 190; ++y) {
    for (int x = 10; x < 190; ++x) {
      const double value = ReadSmoothed(image, x, y).value;
      sum += value;
      square_sum += value * value;
      ++count;
    }
  }
  return std::sqrt(square_sum / count - std::pow(sum / count, 2));
}

TEST(NoisyImages, AreToldByTheirNoiseAgainstTheirContrast) {
  const NoisyImageOptions options;
  ImageQuality quality;
  quality.contrast = 50.0;
  quality.noise_levels = 2.0;
  EXPECT_FALSE(IsNoisy(quality, options)) << "a sensor in daylight";
  quality.noise_levels = 3.0;
  quality.contrast = 8.0;  // five stops less light
  EXPECT_TRUE(IsNoisy(quality, options));
}

TEST(NoisyImages, KeepTheNoiseThatIsForetoldWhenSmoothed) {
  const NoisyImageOptions options;
  ImageStore smoothed(1U << 20U);
  const cv::Mat raw = Noise(8.0);
  ASSERT_TRUE(Smooth({{1, raw}}, options.blur_px, &smoothed).ok());
  ImageQuality quality;
  quality.noise_levels = 8.0;
  // Reading leaves the same share of the foretold independent noise as of the raw image's.
  const double foretold = AfterSmoothing(quality, options).noise_levels / 8.0;
  EXPECT_NEAR(ReadDeviation(smoothed.images().at(1)) / ReadDeviation(raw), foretold, 0.06);
  EXPECT_LT(foretold, 0.5);
}

TEST(NoisyImages, AreVerifiedNoLessStrictlyThanOthers) {
  TrackingOptions options;
  options.verification.min_observations = 9;
  options.verification.max_outlier_share = 0.01;
  const TrackingOptions adapted = ForNoisyImages(options);
  EXPECT_EQ(adapted.verification.min_observations, 9);
  EXPECT_EQ(adapted.verification.max_outlier_share, 0.01);
  EXPECT_EQ(adapted.registration.radius_px, options.noisy.radius_px);
  EXPECT_EQ(adapted.registration.max_part_shift_px, options.noisy.max_part_shift_px);
  EXPECT_EQ(adapted.registration.max_center_shift_px, options.noisy.max_center_shift_px);
  EXPECT_TRUE(CheckOptions(adapted).ok());
  // Noise under a wider Gaussian is alike over more pixels.
  options.noisy.blur_px *= 2.0;
  EXPECT_GT(ForNoisyImages(options).registration.noise_correlation,
            2.0 * adapted.registration.noise_correlation);
}

TEST(NoisyImages, SayWhenTheirCopiesCannotBeKept) {
  ImageStore nowhere(0, "/nowhere/at/all");
  const Status status = Smooth({{1, Noise(1.0)}}, 1.2, &nowhere);
  EXPECT_EQ(status.code(), Status::Code::kUnavailable);
}

}  // namespace
}  // namespace scenecalib
