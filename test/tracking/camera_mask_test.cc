#include "scenecalib/tracking/camera_mask.h"

#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>

#include "testing/temporary_directory.h"
#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

class CameraMaskTest : public ::testing::Test {
 protected:
  CameraConfig Camera(const std::string& file) const {
    CameraConfig camera;
    camera.name = "front";
    camera.model = testing::MakePinhole(40, 30, 30.0);
    camera.mask_file = directory_.path() + "/" + file;
    return camera;
  }

  void Write(const std::string& file, const cv::Mat& image) const {
    ASSERT_TRUE(cv::imwrite(directory_.path() + "/" + file, image));
  }

  testing::TemporaryDirectory directory_;
};

TEST_F(CameraMaskTest, IsEmptyWhenTheRigNamesNone) {
  CameraConfig camera = Camera("mask.png");
  camera.mask_file.reset();
  const auto mask = ReadCameraMask(camera);
  ASSERT_TRUE(mask.ok());
  EXPECT_TRUE(mask->empty());
}

TEST_F(CameraMaskTest, TakesAnythingButBlackAsSeen) {
  cv::Mat image(30, 40, CV_8UC3, cv::Scalar(0, 0, 0));
  image.at<cv::Vec3b>(3, 5) = {10, 10, 10};
  Write("mask.png", image);
  const auto mask = ReadCameraMask(Camera("mask.png"));
  ASSERT_TRUE(mask.ok()) << mask.status().message();
  EXPECT_EQ(cv::countNonZero(*mask), 1);
  EXPECT_EQ(mask->at<uchar>(3, 5), 255);
}

TEST_F(CameraMaskTest, NamesCameraAndFileWhenItCannotBeUsed) {
  const auto missing = ReadCameraMask(Camera("none.png"));
  ASSERT_FALSE(missing.ok());
  EXPECT_EQ(missing.status().code(), Status::Code::kNotFound);
  EXPECT_NE(missing.status().message().find("camera front: mask "), std::string::npos);
  EXPECT_NE(missing.status().message().find("none.png cannot be read"), std::string::npos);
  Write("size.png", cv::Mat(30, 41, CV_8UC1, cv::Scalar(255)));
  const auto size = ReadCameraMask(Camera("size.png"));
  ASSERT_FALSE(size.ok());
  EXPECT_NE(size.status().message().find("is 41x30, must be 40x30"), std::string::npos);
  Write("black.png", cv::Mat(30, 40, CV_8UC1, cv::Scalar(0)));
  EXPECT_FALSE(ReadCameraMask(Camera("black.png")).ok());
}

}  // namespace
}  // namespace scenecalib
