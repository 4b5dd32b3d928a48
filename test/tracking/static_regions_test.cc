#include "scenecalib/tracking/static_regions.h"

#include <gtest/gtest.h>

#include <functional>
#include <map>
#include <opencv2/imgproc.hpp>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/so3.h"
#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

using testing::HitPlanes;
using testing::Texture;
using testing::TexturedPlane;

constexpr int kWidth = 400;
constexpr int kHeight = 300;
constexpr int kNumImages = 14;
constexpr int kTilePx = 8;

/// A camera that drives along a road between two facades, below a sky without texture.
class StaticRegionsTest : public ::testing::Test {
 protected:
  static std::vector<TexturedPlane> Street() {
    return {
        {{0, 1.5, 0}, Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitZ(), Texture(1, 0.25, 2.0)},
        {{4, 0, 0}, Eigen::Vector3d::UnitZ(), Eigen::Vector3d::UnitY(), Texture(2, 0.25, 2.0)}};
  }

  static Rigid3 MapFromCamera(int i) {
    return {ExpSo3({0.0, 0.05 * std::sin(0.7 * i), 0.0}), {0.0, 0.0, 0.6 * i}};
  }

  static CameraModelPtr Model() {
    static const CameraModelPtr model = testing::MakePinhole(kWidth, kHeight, 220.0);
    return model;
  }

  static cv::Mat SceneImage(int i) {
    static std::map<int, cv::Mat> images;
    cv::Mat& image = images[i];
    if (image.empty()) image = testing::RenderPlanes(Street(), *Model(), MapFromCamera(i), 1.0, i);
    return image.clone();
  }

  static std::optional<SceneFlow> Flow(int i) {
    Random random(static_cast<std::uint64_t>(i));
    std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> pixels;
    while (pixels.size() < 200) {
      const Eigen::Vector2d pixel(random.Uniform(5.0, kWidth - 6.0),
                                  random.Uniform(5.0, kHeight - 6.0));
      const auto hit = HitPlanes(Street(), *Model(), MapFromCamera(i - 1), pixel);
      if (!hit) continue;
      const auto after = Model()->Project(MapFromCamera(i).Inverse() * hit->point_in_map_m);
      if (after) pixels.emplace_back(pixel, *after);
    }
    return SceneFlow::Estimate(*Model(), pixels, 1.0, {});
  }

  StaticRegionsTest() : domain_(kHeight, kWidth, CV_8UC1, cv::Scalar(255)) {}

  /// Takes in images [begin, end), each changed by `paint`.
  static void Drive(int begin, int end, const std::function<void(cv::Mat*)>& paint,
                    StaticRegions* regions) {
    for (int i = begin; i < end; ++i) {
      cv::Mat image = SceneImage(i);
      paint(&image);
      const auto flow = Flow(i);
      ASSERT_TRUE(flow);
      regions->Add(BuildFlowPyramid(image, false, {}), &*flow, 1);
    }
  }

  /// A bonnet below a row: textured along its rim, and smooth paint below.
  static std::function<void(cv::Mat*)> Bonnet(int top) {
    return [top](cv::Mat* image) {
      const Texture texture(9, 8.0, 30.0);
      for (int y = top; y < image->rows; ++y) {
        for (int x = 0; x < image->cols; ++x) {
          image->at<uchar>(y, x) = y < top + 24 ? testing::ToGrey(texture(x, y)) : uchar{70};
        }
      }
    };
  }

  /// Share of an area that is masked.
  static double Masked(const StaticRegions& regions, const cv::Rect& area) {
    if (regions.mask().empty()) return 0.0;
    return static_cast<double>(cv::countNonZero(regions.mask()(area))) / area.area();
  }

  static cv::Rect Rows(int begin, int end) { return {0, begin, kWidth, end - begin}; }

  cv::Mat domain_;
  StaticRegionOptions options_;
};

TEST_F(StaticRegionsTest, FindABonnetWithItsSmoothPartsAndNothingElse) {
  StaticRegions regions(domain_, options_);
  Drive(1, kNumImages, Bonnet(240), &regions);
  EXPECT_GT(Masked(regions, Rows(240, kHeight)), 0.9);
  EXPECT_LT(Masked(regions, Rows(0, 240 - kTilePx)), 0.01) << "the sky is smooth, too";
}

TEST_F(StaticRegionsTest, LearnNothingWhileTheVehicleStands) {
  StaticRegions regions(domain_, options_);
  for (int i = 0; i < 3 * kNumImages; ++i) {
    EXPECT_FALSE(regions.Add(BuildFlowPyramid(SceneImage(1), false, {}), nullptr, 1));
  }
  EXPECT_TRUE(regions.mask().empty());
}

TEST_F(StaticRegionsTest, NeedEnoughLooks) {
  StaticRegions regions(domain_, options_);
  Drive(1, options_.min_samples, Bonnet(240), &regions);
  EXPECT_TRUE(regions.mask().empty());
}

TEST_F(StaticRegionsTest, AnEdgeAlongTheMotionIsNotStatic) {
  StaticRegions regions(domain_, options_);
  for (int i = 1; i < 2 * kNumImages; ++i) {
    // Straight on, so that the edges of long stripes on the road stay where they are.
    const Rigid3 map_from_camera(Eigen::Quaterniond::Identity(), {0.0, 0.0, 0.6 * i});
    const cv::Mat image = testing::Render(kWidth, kHeight, [&](double x, double y) {
      const auto ray = Model()->Unproject({x, y});
      if (!ray || ray->y() < 0.05) return 90.0;
      const double across_m = 1.5 * ray->x() / ray->y();
      return 120.0 + 60.0 * std::tanh(20.0 * (std::abs(across_m) - 1.0));
    });
    std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> pixels;
    Random random(static_cast<std::uint64_t>(i));
    while (pixels.size() < 200) {
      const Eigen::Vector2d pixel(random.Uniform(5.0, kWidth - 6.0), random.Uniform(165.0, 290.0));
      const auto hit = HitPlanes({Street()[0]}, *Model(), {}, pixel);
      if (!hit) continue;
      const auto after = Model()->Project(hit->point_in_map_m - Eigen::Vector3d(0.0, 0.0, 0.6));
      if (after) pixels.emplace_back(pixel, *after);
    }
    const auto flow = SceneFlow::Estimate(*Model(), pixels, 1.0, {});
    ASSERT_TRUE(flow);
    regions.Add(BuildFlowPyramid(image, false, {}), &*flow, 1);
  }
  EXPECT_LT(Masked(regions, Rows(0, kHeight)), 0.02);
}

TEST_F(StaticRegionsTest, MoreThanTheLimitIsNeverTakenForStatic) {
  options_.max_share = 0.1;
  StaticRegions regions(domain_, options_);
  Drive(1, kNumImages, Bonnet(240), &regions);
  EXPECT_TRUE(regions.mask().empty()) << "a fifth of the image is the bonnet";
}

TEST_F(StaticRegionsTest, WhatGoesAwayIsReleased) {
  StaticRegions regions(domain_, options_);
  Drive(1, kNumImages, Bonnet(240), &regions);
  ASSERT_GT(Masked(regions, Rows(240, kHeight)), 0.9);
  for (int k = 0; k < 3; ++k)
    Drive(
        1, kNumImages, [](cv::Mat*) {}, &regions);
  EXPECT_LT(Masked(regions, Rows(240, kHeight)), 0.05);
}

TEST_F(StaticRegionsTest, AreNotLookedForWithoutSamples) {
  options_.min_samples = 0;
  StaticRegions regions(domain_, options_);
  Drive(1, kNumImages, Bonnet(240), &regions);
  EXPECT_TRUE(regions.mask().empty());
}

}  // namespace
}  // namespace scenecalib
