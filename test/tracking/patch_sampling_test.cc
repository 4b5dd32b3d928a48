#include "../../src/tracking/patch_sampling.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "../../src/tracking/pixel_grid.h"
#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

cv::Mat NoiseImage() {
  cv::Mat image(60, 80, CV_8UC1);
  Random random(4);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      image.at<uchar>(y, x) = static_cast<uchar>(random.Uniform(0.0, 255.9));
    }
  }
  return image;
}

PatchPixels Pixels(int radius_px, int stride) {
  PatchPixels pixels;
  pixels.radius_px = radius_px;
  pixels.stride = stride;
  pixels.warp.center_px = {40.3, 29.6};
  pixels.warp.affine << 1.1, 0.2, -0.15, 0.9;
  pixels.warp.quadratic << 1e-3, -2e-3, 5e-4, -8e-4, 1e-3, 6e-4;
  return pixels;
}

std::vector<float> Read(PatchSampler sampler, const cv::Mat& image, const PatchPixels& pixels) {
  const int edge = 2 * pixels.radius_px / pixels.stride + 1;
  // One more, which no sampler may write to.
  std::vector<float> values(static_cast<std::size_t>(edge * edge) + 1, -1.0F);
  sampler(image, pixels, values.data());
  EXPECT_EQ(values.back(), -1.0F);
  values.pop_back();
  return values;
}

TEST(PatchSampling, ReadsTheSplineWhereTheWarpLeads) {
  const cv::Mat image = NoiseImage();
  const PatchPixels pixels = Pixels(7, 1);
  const std::vector<float> values = Read(PortableSampler(PatchReading::kSmooth), image, pixels);
  std::size_t i = 0;
  for (int y = -7; y <= 7; ++y) {
    for (int x = -7; x <= 7; ++x, ++i) {
      const Eigen::Vector2d at = pixels.warp({x, y});
      // Weights in steps of 1/512 px of an image of noise.
      EXPECT_NEAR(values[i], ReadGridSmoothed(image, at, 0).value(0, 0), 0.3);
    }
  }
}

TEST(PatchSampling, VectorsReadWhatTheProcessorsAllRead) {
  const cv::Mat image = NoiseImage();
  for (const PatchReading reading : {PatchReading::kSmooth, PatchReading::kBilinear}) {
    const PatchSampler vector = VectorSampler(reading);
    if (vector == nullptr) GTEST_SKIP() << "this processor has no AVX2";
    for (const int radius_px : {1, 4, 7, 10, 15}) {
      for (const int stride : {1, 2}) {
        const PatchPixels pixels = Pixels(radius_px, stride);
        const std::vector<float> expected = Read(PortableSampler(reading), image, pixels);
        const std::vector<float> values = Read(vector, image, pixels);
        ASSERT_EQ(values.size(), expected.size());
        for (std::size_t i = 0; i < values.size(); ++i) {
          EXPECT_NEAR(values[i], expected[i], reading == PatchReading::kSmooth ? 0.3 : 0.01);
        }
      }
    }
  }
}

/// What lies outside of an image is not its own: a patch in its very corner reads nothing of it.
TEST(PatchSampling, VectorsStayInsideTheImage) {
  for (const PatchReading reading : {PatchReading::kSmooth, PatchReading::kBilinear}) {
    const PatchSampler vector = VectorSampler(reading);
    if (vector == nullptr) GTEST_SKIP() << "this processor has no AVX2";
    cv::Mat around(40, 40, CV_8UC1, cv::Scalar(255));
    const cv::Mat image = around(cv::Rect(10, 10, 20, 20));
    around(cv::Rect(10, 10, 20, 20)).setTo(7);
    PatchPixels pixels;
    pixels.radius_px = 8;
    pixels.warp.center_px = {9.5, 9.5};
    for (const float value : Read(vector, image, pixels)) EXPECT_NEAR(value, 7.0F, 1e-4);
  }
}

}  // namespace
}  // namespace scenecalib
