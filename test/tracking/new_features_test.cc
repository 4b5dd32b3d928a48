#include "scenecalib/tracking/new_features.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "scenecalib/tracking/scene_flow.h"
#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

constexpr int kWidth = 800;  // searched at half size
constexpr int kHeight = 400;

class NewFeaturesTest : public ::testing::Test {
 protected:
  NewFeaturesTest() {
    options_.max_features = 150;
    options_.bucket_px = 200;
    options_.bucket_share = 2.0;
    const testing::Texture texture(5, 12.0, 60.0);
    pyramid_ = BuildFlowPyramid(testing::Render(kWidth, kHeight, texture), false, {});
    surroundings_.domain = cv::Mat(kHeight, kWidth, CV_8UC1, cv::Scalar(255));
    surroundings_.allowed = surroundings_.domain;
  }

  static int NumOnTheLeft(const std::vector<Eigen::Vector2d>& features) {
    return static_cast<int>(
        std::count_if(features.begin(), features.end(),
                      [](const Eigen::Vector2d& pixel) { return pixel.x() < 0.5 * kWidth; }));
  }

  DetectionOptions options_;
  FlowPyramid pyramid_;
  FeatureSurroundings surroundings_;
};

TEST(DetectionOptions, AWideCameraHasMoreFeaturesNearerToEachOther) {
  DetectionOptions options;
  options.max_features = 1000;
  options.min_distance_px = 6.0;
  options.max_wide_factor = 1.5;
  const auto wide = [&options](double max_theta_deg) {
    return ForFieldOfView(options, max_theta_deg * M_PI / 180.0);
  };
  EXPECT_EQ(wide(15.0).max_features, 1000);
  EXPECT_EQ(wide(15.0).min_distance_px, 6.0);
  EXPECT_EQ(wide(45.0).max_features, 1000);
  EXPECT_EQ(wide(54.0).max_features, 1200);
  EXPECT_NEAR(wide(54.0).min_distance_px, 5.0, 1e-9);
  EXPECT_EQ(wide(100.0).max_features, 1500);
  EXPECT_NEAR(wide(100.0).min_distance_px, 4.0, 1e-9);
  options.max_wide_factor = 1.0;
  EXPECT_EQ(wide(100.0).max_features, 1000);
}

TEST_F(NewFeaturesTest, ArePixelsOfTheFullImage) {
  ASSERT_EQ(pyramid_.scale(), 2.0);
  double right = 0.0;
  for (const Eigen::Vector2d& pixel : NewFeatures(options_).Find(pyramid_, surroundings_)) {
    right = std::max(right, pixel.x());
  }
  EXPECT_GT(right, 0.9 * kWidth);
}

TEST_F(NewFeaturesTest, KeepOffWhatIsFollowedFixedOrStraddlesAnEdge) {
  surroundings_.allowed = surroundings_.domain.clone();
  surroundings_.allowed(cv::Rect(0, 300, kWidth, 100)).setTo(0);
  surroundings_.avoided = {{200.0, 150.0}};
  surroundings_.avoided_radius_px = 60;
  surroundings_.live = {{600.0, 150.0}};
  const auto features = NewFeatures(options_).Find(pyramid_, surroundings_);
  ASSERT_GT(features.size(), 50U);
  for (const Eigen::Vector2d& pixel : features) {
    EXPECT_LT(pixel.y(), 300.0);
    EXPECT_GE((pixel - surroundings_.avoided[0]).norm(), 58.0);
    EXPECT_GE((pixel - surroundings_.live[0]).norm(), options_.min_distance_px);
  }
}

TEST_F(NewFeaturesTest, KeepOffWhatTwoMoreImagesWillNotSee) {
  // Ahead over a road 1.5 m below.
  const CameraModelPtr model = testing::MakeFisheye(kWidth, kHeight, 200.0);
  const auto after = [&](const Eigen::Vector2d& pixel) {
    const Eigen::Vector3d ray = *model->Unproject(pixel);
    return model->Project(1.5 / ray.y() * ray - Eigen::Vector3d(0.02, 0.0, 0.7));
  };
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> followed;
  for (int x = 150; x < 650; x += 25) {
    for (int y = 230; y < 290; y += 10) {
      const auto next = after({x, y});
      if (next) followed.emplace_back(Eigen::Vector2d(x, y), *next);
    }
  }
  const auto flow = SceneFlow::Estimate(*model, followed, 1.0, {});
  ASSERT_TRUE(flow);
  const auto num_doomed = [&](const std::vector<Eigen::Vector2d>& features) {
    return std::count_if(features.begin(), features.end(), [&](const Eigen::Vector2d& pixel) {
      const auto next = flow->Predict(pixel);
      if (!next) return true;
      const auto last = flow->Predict(next->center_px);
      return !last;
    });
  };
  const auto anywhere = NewFeatures(options_).Find(pyramid_, surroundings_);
  ASSERT_GT(num_doomed(anywhere), 20);
  surroundings_.flow = &*flow;
  const auto features = NewFeatures(options_).Find(pyramid_, surroundings_);
  ASSERT_GT(features.size(), 50U);
  // Decided cell by cell.
  EXPECT_LT(num_doomed(features), num_doomed(anywhere) / 3);
}

TEST_F(NewFeaturesTest, AreTriedLessWhereTheyWereLost) {
  NewFeatures learner(options_);
  const auto before = learner.Find(pyramid_, surroundings_);
  for (int image = 0; image < 30; ++image) {
    std::vector<FeatureTrial> trials;
    for (const Eigen::Vector2d& pixel : before) {
      trials.push_back({pixel, pixel.x() >= 0.5 * kWidth});
    }
    learner.Learn(pyramid_, trials);
  }
  const auto after = learner.Find(pyramid_, surroundings_);
  EXPECT_LT(NumOnTheLeft(after), NumOnTheLeft(before) / 2);
  EXPECT_GT(NumOnTheLeft(after), 0) << "a few are tried all the same";
  EXPECT_GE(static_cast<int>(after.size()) - NumOnTheLeft(after),
            static_cast<int>(before.size()) - NumOnTheLeft(before));
}

}  // namespace
}  // namespace scenecalib
