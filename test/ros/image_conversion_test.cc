#include "scenecalib/ros/image_conversion.h"

#include <gtest/gtest.h>
#include <sensor_msgs/image_encodings.h>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

namespace scenecalib {
namespace {

namespace encodings = sensor_msgs::image_encodings;

constexpr int kWidth = 32;
constexpr int kHeight = 16;

/// An image of one grey value, with padding at the end of each row.
sensor_msgs::Image Uniform(const std::string& encoding, int bytes_per_pixel, int value) {
  sensor_msgs::Image image;
  image.header.stamp = ros::Time(12, 345);
  image.encoding = encoding;
  image.width = kWidth;
  image.height = kHeight;
  image.step = static_cast<std::uint32_t>(kWidth * bytes_per_pixel + 8);
  image.data.assign(image.step * image.height, static_cast<std::uint8_t>(value));
  return image;
}

class EightBitEncoding : public testing::TestWithParam<const char*> {};

TEST_P(EightBitEncoding, KeepsGreyGrey) {
  const int bytes = encodings::numChannels(GetParam());
  ImageConverter converter;
  const Result<GrayImage> gray = converter.Convert(Uniform(GetParam(), bytes, 90));
  ASSERT_TRUE(gray.ok()) << gray.status().message();
  EXPECT_EQ(gray->stamp_ns, 12000000345);
  ASSERT_EQ(gray->pixels.type(), CV_8UC1);
  ASSERT_EQ(gray->pixels.size(), cv::Size(kWidth, kHeight));
  EXPECT_NEAR(cv::mean(gray->pixels)[0], 90.0, 1.0);
}

INSTANTIATE_TEST_SUITE_P(All, EightBitEncoding,
                         testing::Values("mono8", "8UC1", "rgb8", "bgr8", "rgba8", "bgra8",
                                         "bayer_rggb8", "bayer_bggr8", "bayer_gbrg8",
                                         "bayer_grbg8"));

TEST(ImageConverter, TellsRedFromBlue) {
  sensor_msgs::Image image = Uniform(encodings::RGB8, 3, 0);
  for (std::size_t row = 0; row < kHeight; ++row) {
    for (std::size_t column = 0; column < kWidth; ++column) {
      image.data[row * image.step + 3 * column] = 200;  // red
    }
  }
  ImageConverter converter;
  const double as_rgb = cv::mean(converter.Convert(image)->pixels)[0];
  image.encoding = encodings::BGR8;
  const double as_bgr = cv::mean(converter.Convert(image)->pixels)[0];
  EXPECT_NEAR(as_rgb, 0.299 * 200.0, 1.0);  // ITU-R BT.601
  EXPECT_NEAR(as_bgr, 0.114 * 200.0, 1.0);
}

TEST(ImageConverter, KeepsAnImageInColourAboutOnceASecond) {
  sensor_msgs::Image image = Uniform(encodings::RGB8, 3, 0);
  image.data[0] = 200;  // the first pixel's red
  ImageConverter converter;
  int num_coloured = 0;
  for (int i = 0; i < 30; ++i) {
    image.header.stamp = ros::Time(12.0 + 0.1 * i);
    const Result<GrayImage> gray = converter.Convert(image);
    ASSERT_TRUE(gray.ok());
    if (gray->colour.empty()) continue;
    ++num_coloured;
    ASSERT_EQ(gray->colour.type(), CV_8UC3);
    EXPECT_EQ(gray->colour.at<cv::Vec3b>(0, 0), cv::Vec3b(0, 0, 200));  // blue, green, red
  }
  EXPECT_GE(num_coloured, 3);
  EXPECT_LE(num_coloured, 4);
}

TEST(ImageConverter, KeepsNoColourOfAGreyCamera) {
  ImageConverter converter;
  EXPECT_TRUE(converter.Convert(Uniform(encodings::MONO8, 1, 90))->colour.empty());
}

TEST(ImageConverter, TakesTheLumaOfBothYuv422Orders) {
  sensor_msgs::Image image = Uniform("yuv422", 2, 128);
  for (std::size_t row = 0; row < kHeight; ++row) {
    for (std::size_t column = 0; column < kWidth; ++column) {
      image.data[row * image.step + 2 * column + 1] = 77;  // UYVY: luma second
    }
  }
  ImageConverter converter;
  EXPECT_NEAR(cv::mean(converter.Convert(image)->pixels)[0], 77.0, 0.01);
  image.encoding = "yuv422_yuy2";
  EXPECT_NEAR(cv::mean(converter.Convert(image)->pixels)[0], 128.0, 0.01);
}

/// A mono16 image with values up to `max`.
sensor_msgs::Image Deep(int max, bool is_bigendian) {
  sensor_msgs::Image image = Uniform(encodings::MONO16, 2, 0);
  image.is_bigendian = is_bigendian;
  for (std::size_t row = 0; row < kHeight; ++row) {
    for (std::size_t column = 0; column < kWidth; ++column) {
      const int value = max * static_cast<int>(column) / (kWidth - 1);
      std::uint8_t* pixel = &image.data[row * image.step + 2 * column];
      pixel[is_bigendian ? 1 : 0] = static_cast<std::uint8_t>(value & 0xff);
      pixel[is_bigendian ? 0 : 1] = static_cast<std::uint8_t>(value >> 8);
    }
  }
  return image;
}

TEST(ImageConverter, ScalesMono16ByItsSignificantBits) {
  for (const int bits : {10, 12, 14, 16}) {
    for (const bool is_bigendian : {false, true}) {
      ImageConverter converter;
      const Result<GrayImage> gray = converter.Convert(Deep((1 << bits) - 1, is_bigendian));
      ASSERT_TRUE(gray.ok()) << gray.status().message();
      double max = 0.0;
      cv::minMaxLoc(gray->pixels, nullptr, &max);
      EXPECT_EQ(max, 255.0) << bits << " bits, big endian " << is_bigendian;
      EXPECT_NEAR(cv::mean(gray->pixels)[0], 127.5, 1.0);
    }
  }
}

TEST(ImageConverter, KeepsTheScaleOfMono16WhenAnImageIsDarker) {
  ImageConverter converter;
  ASSERT_TRUE(converter.Convert(Deep(4095, false)).ok());
  double max = 0.0;
  cv::minMaxLoc(converter.Convert(Deep(1000, false))->pixels, nullptr, &max);
  EXPECT_NEAR(max, 1000.0 * 255.0 / 4095.0, 1.0);
}

TEST(ImageConverter, DecodesJpegAndPng) {
  cv::Mat picture(kHeight, kWidth, CV_8UC3, cv::Scalar(90, 90, 90));
  for (const char* extension : {".jpg", ".png"}) {
    sensor_msgs::CompressedImage message;
    message.header.stamp = ros::Time(1, 0);
    ASSERT_TRUE(cv::imencode(extension, picture, message.data));
    const Result<GrayImage> gray = ImageConverter().Convert(message);
    ASSERT_TRUE(gray.ok()) << gray.status().message();
    ASSERT_EQ(gray->pixels.type(), CV_8UC1);
    EXPECT_NEAR(cv::mean(gray->pixels)[0], 90.0, 1.0);
  }
}

TEST(ImageConverter, RefusesWhatIsNotAnImage) {
  ImageConverter converter;
  EXPECT_FALSE(converter.Convert(Uniform("no_such_encoding", 1, 0)).ok());
  EXPECT_FALSE(converter.Convert(sensor_msgs::Image()).ok());
  sensor_msgs::Image cut_off = Uniform(encodings::BGR8, 3, 0);
  cut_off.data.resize(cut_off.data.size() / 2);
  EXPECT_FALSE(converter.Convert(cut_off).ok());
  sensor_msgs::Image bad_step = Uniform(encodings::BGR8, 3, 0);
  bad_step.step = 5;
  EXPECT_FALSE(converter.Convert(bad_step).ok());
  sensor_msgs::CompressedImage garbage;
  garbage.data.assign(100, 7);
  EXPECT_FALSE(converter.Convert(garbage).ok());
  EXPECT_FALSE(converter.Convert(sensor_msgs::CompressedImage()).ok());
}

sensor_msgs::CameraInfo Info() {
  sensor_msgs::CameraInfo info;
  info.width = 640;
  info.height = 480;
  info.distortion_model = "plumb_bob";
  info.D = {-0.1, 0.01, 0.0, 0.0, 0.0};
  info.K = {500.0, 0.0, 319.5, 0.0, 510.0, 239.5, 0.0, 0.0, 1.0};
  return info;
}

TEST(CameraModelFromInfo, ProjectsTheAxisToThePrincipalPoint) {
  const Result<CameraModelPtr> model = CameraModelFromInfo(Info());
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_EQ((*model)->name(), "plumb_bob");
  const auto pixel = (*model)->Project({0.0, 0.0, 1.0});
  ASSERT_TRUE(pixel.has_value());
  EXPECT_NEAR((*pixel - Eigen::Vector2d(319.5, 239.5)).norm(), 0.0, 1e-9);
}

TEST(CameraModelFromInfo, AppliesBinning) {
  sensor_msgs::CameraInfo info = Info();
  info.binning_x = info.binning_y = 2;
  const Result<CameraModelPtr> model = CameraModelFromInfo(info);
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_EQ((*model)->width_px(), 320);
  // The middle of 640 full pixels is the middle of 320 binned ones.
  EXPECT_NEAR((*model)->Project({0.0, 0.0, 1.0})->x(), 159.5, 1e-9);
}

TEST(CameraModelFromInfo, RefusesAnUncalibratedCameraAndAnUnknownModel) {
  sensor_msgs::CameraInfo uncalibrated = Info();
  uncalibrated.K.assign(0.0);
  EXPECT_FALSE(CameraModelFromInfo(uncalibrated).ok());
  sensor_msgs::CameraInfo unknown = Info();
  unknown.distortion_model = "barrel";
  const Result<CameraModelPtr> model = CameraModelFromInfo(unknown);
  ASSERT_FALSE(model.ok());
  EXPECT_NE(model.status().message().find("barrel"), std::string::npos);
}

}  // namespace
}  // namespace scenecalib
