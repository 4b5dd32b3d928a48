#include "../../src/tracking/patch_sampling.h"

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <cmath>
#include <new>
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

void ExpectSameReadings(const cv::Mat& image, const PatchPixels& pixels) {
  for (const PatchReading reading : {PatchReading::kSmooth, PatchReading::kBilinear}) {
    const PatchSampler vector = VectorSampler(reading);
    if (vector == nullptr) GTEST_SKIP() << "this processor has no AVX2";
    const std::vector<float> expected = Read(PortableSampler(reading), image, pixels);
    const std::vector<float> values = Read(vector, image, pixels);
    ASSERT_EQ(values.size(), expected.size());
    for (std::size_t i = 0; i < values.size(); ++i) {
      EXPECT_NEAR(values[i], expected[i], reading == PatchReading::kSmooth ? 0.3 : 0.01);
    }
  }
}

TEST(PatchSampling, VectorsReadWhatTheProcessorsAllRead) {
  const cv::Mat image = NoiseImage();
  for (const int radius_px : {1, 2, 4, 7, 10, 15}) {
    for (const int stride : {1, 2}) ExpectSameReadings(image, Pixels(radius_px, stride));
  }
}

/// Neighbours of a turned, mirrored or stretched patch are far apart in the other image, so that
/// one load does not hold them.
TEST(PatchSampling, VectorsReadPatchesHoweverTheyLie) {
  const cv::Mat image = NoiseImage();
  for (const double angle_rad : {0.3, 0.8, 1.6, 3.1, -0.5, -1.4}) {
    for (const double stretch : {-1.0, 0.4, 1.0, 4.0}) {
      PatchPixels pixels = Pixels(5, 1);
      pixels.warp.affine = Eigen::Rotation2Dd(angle_rad).toRotationMatrix() *
                           Eigen::Vector2d(stretch, 1.0).asDiagonal();
      ExpectSameReadings(image, pixels);
    }
  }
}

/// The noise image where its memory's last page ends: what reads on does not come back.
class ImageAtTheEndOfMemory {
 public:
  ImageAtTheEndOfMemory() {
    const cv::Mat noise = NoiseImage();
    const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
    const std::size_t used = (noise.total() + page - 1) / page * page;
    size_ = used + page;
    memory_ = mmap(nullptr, size_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (memory_ == MAP_FAILED) throw std::bad_alloc();
    auto* end = static_cast<uchar*>(memory_) + used;
    mprotect(end, page, PROT_NONE);
    image_ = cv::Mat(noise.rows, noise.cols, CV_8UC1, end - noise.total());
    noise.copyTo(image_);
  }
  ImageAtTheEndOfMemory(const ImageAtTheEndOfMemory&) = delete;
  ImageAtTheEndOfMemory& operator=(const ImageAtTheEndOfMemory&) = delete;
  ~ImageAtTheEndOfMemory() { munmap(memory_, size_); }

  const cv::Mat& image() const { return image_; }

 private:
  std::size_t size_ = 0;
  void* memory_ = nullptr;
  cv::Mat image_;
};

/// A load of many pixels must not go past the last ones of the image.
TEST(PatchSampling, VectorsReadUpToTheBorders) {
  const ImageAtTheEndOfMemory at_the_end;
  const cv::Mat& image = at_the_end.image();
  for (const double x : {9.6, 40.0, 65.4, 67.9}) {
    for (const double y : {9.3, 30.0, 46.6, 48.9, 49.3}) {
      PatchPixels pixels = Pixels(8, 1);
      pixels.warp.center_px = {x, y};
      pixels.warp.affine << 0.95, 0.1, 0.05, 0.97;
      pixels.warp.quadratic.setZero();
      ExpectSameReadings(image, pixels);
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
