#include "../../src/evaluation/best_pose.h"

#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

/// Pairs of two cameras whose images show the same texture, when the second camera is moved by a
/// known pose.
class BestPoses : public ::testing::Test {
 protected:
  void SetUp() override {
    cv::Mat image(300, 400, CV_8UC1);
    for (int i = 0; i < image.rows * image.cols; ++i) {
      image.data[i] = static_cast<unsigned char>(random_.Uniform() * 255.0);
    }
    cv::GaussianBlur(image, image, {0, 0}, 2.0);
    cv::normalize(image, image, 0, 255, cv::NORM_MINMAX);
    image_ = BandPassImage(image, 0.9);
  }

  /// Of what the other camera sees a share is something else, the rest is noisy. The fourth axis
  /// moves pixels nearly as the second one does: only the far ends of the image tell them apart.
  Comparison Compare(const ScaledPose& true_pose, double wrong_share, double noise) {
    Comparison comparison;
    comparison.image = &image_;
    comparison.other_image = &image_;
    for (int i = 0; i < 20000; ++i) {
      const Eigen::Vector2f at(static_cast<float>(random_.Uniform(-1.0, 1.0)),
                               static_cast<float>(random_.Uniform(-1.0, 1.0)));
      PixelByPose by_pose;
      by_pose << 1.5F, 0.0F, at.x(), at.x() * at.y(), 1.5F + 0.3F * at.x() * at.x(), at.y(),  //
          0.0F, 1.5F, at.y(), 1.5F + 0.3F * at.y() * at.y(), at.x() * at.y(), -at.x();
      const Eigen::Vector2f pixel(200.0F + 180.0F * at.x(), 150.0F + 130.0F * at.y());
      const Eigen::Vector2f seen = pixel + by_pose * true_pose.cast<float>();
      const bool is_wrong = random_.Uniform() < wrong_share;
      comparison.pixels.push_back(pixel);
      comparison.pixels_by_pose.push_back(by_pose);
      comparison.other_pixels.push_back(pixel);
      comparison.other_values.push_back(is_wrong
                                            ? static_cast<float>(random_.Uniform(-2.0, 2.0))
                                            : image_.At(seen.x(), seen.y()) +
                                                  static_cast<float>(noise * random_.Gaussian()));
    }
    return comparison;
  }

  Random random_{5};
  BandPassImage image_;
};

TEST_F(BestPoses, AreFoundWhereTwoAxesLookNearlyAlike) {
  ScaledPose pose;
  pose << 0.1, -0.5, 0.2, 0.4, -0.1, 0.3;
  const std::vector<Comparison> comparisons = {Compare(pose, 0.3, 0.3), Compare(pose, 0.3, 0.3)};
  const std::vector<ScaledPose> found = FindBestPoses(comparisons, {{}, {0, 1}});
  ASSERT_EQ(found.size(), 2u);
  EXPECT_TRUE(found[0].isZero());  // no pairs
  EXPECT_LT((found[1] - pose).cwiseAbs().maxCoeff(), 0.05) << found[1].transpose();
}

TEST_F(BestPoses, StayWithinThePerturbationsRange) {
  ScaledPose pose = ScaledPose::Zero();
  pose[0] = 1.6;
  const std::vector<ScaledPose> found = FindBestPoses({Compare(pose, 0.1, 0.1)}, {{0}});
  EXPECT_EQ(found[0][0], 1.0);
  EXPECT_LE(found[0].cwiseAbs().maxCoeff(), 1.0);
}

TEST_F(BestPoses, AreNotSoughtInOneCamerasImagesAtTwoTimes) {
  ScaledPose pose = ScaledPose::Zero();
  pose[0] = 0.5;
  Comparison comparison = Compare(pose, 0.0, 0.1);
  comparison.same_camera = true;
  EXPECT_TRUE(FindBestPoses({comparison}, {{0}})[0].isZero());
}

}  // namespace
}  // namespace scenecalib
