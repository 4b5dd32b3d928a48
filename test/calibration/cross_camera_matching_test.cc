#include "scenecalib/calibration/cross_camera_matching.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "scenecalib/geometry/so3.h"
#include "testing/canyon_scene.h"

namespace scenecalib {
namespace {

constexpr Timestamp kStampNs = 1700000000000000000;

/// Grey value of a wall's texture: blotches of several sizes, nowhere repeating.
double Texture(double wall_y_m, double wall_z_m) {
  const double y = 2.2 * wall_y_m;
  const double z = 2.2 * wall_z_m;
  return 128.0 + 28.0 * std::sin(5.1 * y + 1.7 * std::sin(2.3 * z)) +
         26.0 * std::sin(7.3 * z - 1.9 * std::sin(3.1 * y)) + 22.0 * std::sin(17.0 * y + 11.0 * z) +
         20.0 * std::sin(13.0 * z - 19.0 * y + 2.0 * std::sin(4.0 * y));
}

/// A wall at x = 10, seen by two cameras of different lenses from different places at different
/// times; a smaller board in front of its left part is not in the texture's plane.
class CrossCameraMatchingTest : public ::testing::Test {
 protected:
  static constexpr double kWallX = 10.0;
  static constexpr double kBoardX = 8.0;

  void SetUp() override {
    cameras_.resize(2);
    Add(0, testing::CanyonCamera("front", 0.0, 700.0, false),
        Rigid3(ExpSo3({0.0, 0.0, 0.05}), {0.0, 0.3, 1.0}));
    Add(1, testing::CanyonCamera("wide", 0.1, 420.0, true),
        Rigid3(ExpSo3({0.01, 0.02, -0.1}), {2.8, -0.8, 1.2}));
    map_.surfels = {testing::Disc({static_cast<float>(kWallX), 0.0F, 1.0F}, {-1, 0, 0}, 12.0F)};
  }

  void Add(int index, const CameraConfig& config, const Rigid3& map_from_lidar) {
    const Timestamp stamp = kStampNs + 3000000000LL * index;
    true_poses_[index] = map_from_lidar * config.lidar_from_camera;
    images_[index][stamp] = Render(*config.model, true_poses_[index]);
    cameras_[index].model = config.model;
    cameras_[index].images = &images_[index];
    cameras_[index].poses[stamp] = true_poses_[index];
  }

  cv::Mat Render(const CameraModel& model, const ImagePose& pose) const {
    cv::Mat1b image(model.height_px(), model.width_px(), uchar{0});
    for (int v = 0; v < image.rows; ++v) {
      const Rigid3 map_from_camera = pose.At(v);
      for (int u = 0; u < image.cols; ++u) {
        const auto ray = model.Unproject(Eigen::Vector2d(u, v));
        if (!ray) continue;
        const Eigen::Vector3d direction = map_from_camera.rotation * *ray;
        if (direction.x() < 0.05) continue;
        const Eigen::Vector3d point =
            map_from_camera.translation +
            (kWallX - map_from_camera.translation.x()) / direction.x() * direction;
        const double grey = gain_ * Texture(point.y(), point.z());
        image(v, u) = cv::saturate_cast<uchar>(grey);
      }
    }
    return image;
  }

  /// Feature points on the wall that both cameras see.
  void AddPoints() {
    for (int i = 0; i < 2; ++i) {
      for (double y = -2.0; y <= 2.0; y += 0.4) {
        for (double z = 0.2; z <= 2.0; z += 0.45) {
          const Eigen::Vector3d point(kWallX, y, z);
          const auto pixel = true_poses_[i].Project(*cameras_[i].model, point);
          if (!pixel) continue;
          FeaturePoint feature;
          feature.point_in_map_m = point;
          feature.normal_in_map = -Eigen::Vector3d::UnitX();
          feature.reference_stamp_ns = images_[i].begin()->first;
          feature.reference_px = *pixel;
          feature.stamps_ns = {feature.reference_stamp_ns};
          cameras_[i].points.push_back(feature);
        }
      }
    }
  }

  CrossCameraMatching Match(const CrossCameraOptions& options = {}) const {
    return MatchAcrossCameras(cameras_, RayCaster::Create(map_).value(), options);
  }

  double ErrorOf(const CrossCameraMatch& match, const Eigen::Vector2d& pixel) const {
    const FeaturePoint& point = cameras_[match.source_camera].points[match.source_point];
    const auto truth = true_poses_[match.target_camera].Project(
        *cameras_[match.target_camera].model, point.point_in_map_m);
    return truth ? (*truth - pixel).norm() : 1e9;
  }

  double gain_ = 1.0;
  SceneMap map_;
  std::array<ImagePose, 2> true_poses_;
  std::array<std::map<Timestamp, cv::Mat>, 2> images_;
  std::vector<MatchingCamera> cameras_;
};

TEST_F(CrossCameraMatchingTest, FindsThePixelAlthoughTheCalibrationIsOff) {
  AddPoints();
  // The second camera's pose is off by some four pixels.
  for (auto& pose : cameras_[1].poses) {
    pose.second =
        pose.second.map_from_camera() * Rigid3(ExpSo3({0.006, -0.007, 0.004}), {0.01, -0.02, 0.01});
  }
  const CrossCameraMatching matching = Match();
  ASSERT_GT(matching.matches.size(), 40U);
  for (const CrossCameraMatch& match : matching.matches) {
    EXPECT_GT((match.predicted_px - match.pixel).norm(), 1.0);
    EXPECT_LT(ErrorOf(match, match.pixel), 0.15) << "from camera " << match.source_camera;
    EXPECT_LT(ErrorOf(match, match.correlation_px), 1.0);
  }
}

TEST_F(CrossCameraMatchingTest, FollowsRollingShutters) {
  // While the images are read out, one vehicle's camera moves by 16 cm and turns by half a degree.
  const Rigid3 half(ExpSo3({0.0, 0.004, 0.002}), {0.08, 0.01, 0.02});
  for (int i = 0; i < 2; ++i) {
    const Rigid3 middle = true_poses_[i].map_from_camera();
    const Timestamp stamp = images_[i].begin()->first;
    true_poses_[i] =
        ImagePose(middle * half.Inverse(), middle, middle * half, cameras_[i].model->height_px());
    images_[i][stamp] = Render(*cameras_[i].model, true_poses_[i]);
    cameras_[i].poses[stamp] = true_poses_[i];
  }
  AddPoints();
  const CrossCameraMatching matching = Match();
  ASSERT_GT(matching.matches.size(), 40U);
  for (const CrossCameraMatch& match : matching.matches) {
    EXPECT_LT(ErrorOf(match, match.predicted_px), 0.01);
    EXPECT_LT(ErrorOf(match, match.pixel), 0.15) << "from camera " << match.source_camera;
  }
}

TEST_F(CrossCameraMatchingTest, ExposureOfTheOtherCameraDoesNotMatter) {
  gain_ = 0.35;
  images_[1].begin()->second = Render(*cameras_[1].model, true_poses_[1]);
  AddPoints();
  const CrossCameraMatching matching = Match();
  ASSERT_GT(matching.matches.size(), 40U);
  for (const CrossCameraMatch& match : matching.matches) {
    EXPECT_LT(ErrorOf(match, match.pixel), 0.15);
  }
}

TEST_F(CrossCameraMatchingTest, ABlurredImageGivesWayToASharpNeighbour) {
  AddPoints();
  CrossCameraOptions options;
  options.max_views_per_point = 1;
  const Timestamp first = images_[1].begin()->first;
  const Timestamp second = first + 100000000;
  images_[1][second] = images_[1].at(first).clone();
  cameras_[1].poses[second] = true_poses_[1];
  for (FeaturePoint& point : cameras_[1].points) point.stamps_ns.push_back(second);
  const auto num_into = [&](Timestamp stamp) {
    const auto matches = Match(options).matches;
    return std::count_if(matches.begin(), matches.end(), [&](const CrossCameraMatch& match) {
      return match.target_camera == 1 && match.target_stamp_ns == stamp;
    });
  };
  EXPECT_GT(num_into(first), 20) << "both are as near in scale; the first comes first";
  EXPECT_EQ(num_into(second), 0);
  cameras_[1].relative_sharpness = {{first, 0.6}, {second, 1.0}};
  EXPECT_EQ(num_into(first), 0);
  EXPECT_GT(num_into(second), 20);
  // A little less sharp is as good.
  cameras_[1].relative_sharpness = {{first, 0.95}, {second, 1.05}};
  EXPECT_GT(num_into(first), 20);
}

TEST_F(CrossCameraMatchingTest, APointBehindSomethingIsNotMatched) {
  AddPoints();
  map_.surfels.push_back(
      testing::Disc({static_cast<float>(kBoardX), 0.0F, 1.0F}, {-1, 0, 0}, 6.0F));
  const CrossCameraMatching matching = Match();
  EXPECT_GT(matching.num_candidates, 40);
  EXPECT_EQ(matching.num_occluded, matching.num_candidates);
  EXPECT_TRUE(matching.matches.empty());
}

TEST_F(CrossCameraMatchingTest, SomethingElseInTheImageIsNotMatched) {
  AddPoints();
  cv::Mat& image = images_[1].begin()->second;
  cv::Mat noise(image.size(), CV_8UC1);
  Random random(3);
  for (int v = 0; v < noise.rows; ++v) {
    for (int u = 0; u < noise.cols; ++u) {
      noise.at<uchar>(v, u) = static_cast<uchar>(255.0 * random.Uniform());
    }
  }
  image = noise;
  const CrossCameraMatching matching = Match();
  EXPECT_GT(matching.num_unlike, 40);
  EXPECT_TRUE(matching.matches.empty());
}

TEST_F(CrossCameraMatchingTest, AFlatWallIsNotMatched) {
  gain_ = 0.0;
  for (int i = 0; i < 2; ++i) {
    images_[i].begin()->second = Render(*cameras_[i].model, true_poses_[i]);
  }
  AddPoints();
  EXPECT_TRUE(Match().matches.empty());
}

TEST_F(CrossCameraMatchingTest, CamerasThatNeverSawTheSamePlaceGiveNothing) {
  AddPoints();
  for (FeaturePoint& point : cameras_[1].points) point.point_in_map_m.y() += 50.0;
  const CrossCameraMatching matching = Match();
  EXPECT_EQ(matching.num_candidates, 0);
}

TEST_F(CrossCameraMatchingTest, NothingIsDoneWhenItIsOff) {
  AddPoints();
  CrossCameraOptions options;
  options.enabled = false;
  EXPECT_EQ(Match(options).num_candidates, 0);
}

}  // namespace
}  // namespace scenecalib
