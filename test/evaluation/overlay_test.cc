#include "scenecalib/evaluation/overlay.h"

#include <gtest/gtest.h>

#include <cmath>

#include "evaluation_fixture.h"

namespace scenecalib {
namespace {

/// A wall across the lidar's x axis, sampled every 0.1 m.
std::vector<MapPoint> Wall(double x_m, double half_width_m) {
  std::vector<MapPoint> points;
  const int steps = static_cast<int>(std::lround(half_width_m / 0.1));
  for (int i = -steps; i <= steps; ++i) {
    for (int j = -steps; j <= steps; ++j) {
      points.push_back({Eigen::Vector3f(static_cast<float>(x_m), 0.1F * static_cast<float>(i),
                                        0.1F * static_cast<float>(j)),
                        0.0F});
    }
  }
  return points;
}

/// With the lidar at the map's origin.
Rigid3 MapFromCamera() { return ForwardCamera("front").lidar_from_camera; }

TEST(Overlay, PointsBehindANearerSurfaceAreHidden) {
  std::vector<MapPoint> points = Wall(5.0, 1.0);
  const std::size_t num_near = points.size();
  for (const MapPoint& point : Wall(20.0, 6.0)) points.push_back(point);
  int num_near_seen = 0;
  int num_far_seen = 0;
  for (const VisiblePoint& point : FindVisiblePoints(*ForwardCamera("front").model, points,
                                                     MapFromCamera(), OverlayOptions())) {
    if (point.index < num_near) {
      ++num_near_seen;
      continue;
    }
    ++num_far_seen;
    const Eigen::Vector3f& p = points[point.index].position_m;
    // The near wall covers 4 m of the far one to each side.
    EXPECT_GT(std::max(std::abs(p.y()), std::abs(p.z())), 3.8) << p.transpose();
  }
  EXPECT_EQ(num_near_seen, static_cast<int>(num_near));
  EXPECT_GT(num_far_seen, 1000);
}

TEST(Overlay, GroundSeenAtAGrazingAngleDoesNotHideItself) {
  std::vector<MapPoint> points;
  for (int i = 0; i < 350; ++i) {
    for (int j = -20; j <= 20; ++j) {
      points.push_back({Eigen::Vector3f(5.0F + 0.15F * static_cast<float>(i),
                                        0.15F * static_cast<float>(j), -1.7F),
                        0.0F});
    }
  }
  const CameraConfig camera = ForwardCamera("front");
  const Rigid3 camera_from_map = MapFromCamera().Inverse();
  std::size_t num_inside = 0;
  for (const MapPoint& point : points) {
    if (camera.model->Project(camera_from_map * point.position_m.cast<double>())) ++num_inside;
  }
  const auto visible = FindVisiblePoints(*camera.model, points, MapFromCamera(), OverlayOptions());
  EXPECT_EQ(visible.size(), num_inside);
}

TEST(Overlay, PointsOutOfRangeOrBehindTheCameraAreNotVisible) {
  const std::vector<MapPoint> points = {{{1.0F, 0.0F, 0.0F}, 0.0F},
                                        {{200.0F, 0.0F, 0.0F}, 0.0F},
                                        {{-10.0F, 0.0F, 0.0F}, 0.0F},
                                        {{10.0F, 0.0F, 0.0F}, 0.0F}};
  const auto visible =
      FindVisiblePoints(*ForwardCamera("front").model, points, MapFromCamera(), OverlayOptions());
  ASSERT_EQ(visible.size(), 1u);
  EXPECT_EQ(visible[0].index, 3u);
  EXPECT_NEAR(visible[0].range_m, 10.0, 1e-6);
  EXPECT_LT((visible[0].pixel - Eigen::Vector2d(319.5, 239.5)).norm(), 1e-4);
}

TEST(Overlay, PointsLieWhereARollingShutterSawThem) {
  const CameraModelPtr model = ForwardCamera("front").model;
  // 16 cm to the side while the image is read out.
  const auto at = [](double right_m) {
    return MapFromCamera() * Rigid3(Eigen::Quaterniond::Identity(), {right_m, 0.0, 0.0});
  };
  const ImagePose pose(at(-0.08), at(0.0), at(0.08), model->height_px());
  const std::vector<MapPoint> points = Wall(10.0, 3.0);
  const auto visible = FindVisiblePoints(*model, points, pose, OverlayOptions());
  ASSERT_EQ(visible.size(), points.size());
  double farthest_px = 0.0;
  for (const VisiblePoint& seen : visible) {
    const Eigen::Vector3d point = points[seen.index].position_m.cast<double>();
    const auto then = model->Project(pose.At(seen.pixel.y()).Inverse() * point);
    ASSERT_TRUE(then);
    EXPECT_LT((*then - seen.pixel).norm(), 1e-3);
    const auto at_once = model->Project(pose.map_from_camera().Inverse() * point);
    farthest_px = std::max(farthest_px, (*at_once - seen.pixel).norm());
  }
  EXPECT_GT(farthest_px, 1.0);
}

TEST(Overlay, DrawsWarmDotsNearAndColdDotsFar) {
  const cv::Mat image(480, 640, CV_8UC1, cv::Scalar(100));
  const auto dot = [&image](float x_m) {
    const auto overlay = DrawOverlay(image, ForwardCamera("front"), {{{x_m, 0.0F, 0.0F}, 0.0F}},
                                     MapFromCamera(), "", OverlayOptions());
    EXPECT_TRUE(overlay.ok()) << overlay.status().message();
    EXPECT_EQ(overlay->type(), CV_8UC3);
    EXPECT_EQ(overlay->size(), image.size());
    EXPECT_EQ(overlay->at<cv::Vec3b>(100, 100), cv::Vec3b(80, 80, 80));  // the dimmed image
    return overlay->at<cv::Vec3b>(240, 320);
  };
  const cv::Vec3b near = dot(2.2F);
  const cv::Vec3b far = dot(75.0F);
  EXPECT_GT(near[2], near[0] + 50);  // red over blue
  EXPECT_GT(far[0], far[2] + 50);
}

TEST(Overlay, MovesWithThePoseOfTheLidar) {
  const cv::Mat image(480, 640, CV_8UC3, cv::Scalar::all(0));
  const Rigid3 map_from_lidar(Eigen::Quaterniond::Identity(), {100.0, 0.0, 0.0});
  const auto overlay = DrawOverlay(image, ForwardCamera("front"), {{{110.0F, 0.0F, 0.0F}, 0.0F}},
                                   map_from_lidar * MapFromCamera(), "", OverlayOptions());
  ASSERT_TRUE(overlay.ok());
  EXPECT_NE(overlay->at<cv::Vec3b>(240, 320), cv::Vec3b(0, 0, 0));
}

TEST(Overlay, RefusesImagesOfAnotherSizeOrType) {
  const CameraConfig camera = ForwardCamera("front");
  const auto message = [&camera](const cv::Mat& image, const OverlayOptions& options) {
    return DrawOverlay(image, camera, {}, MapFromCamera(), "", options).status().message();
  };
  EXPECT_EQ(message(cv::Mat(10, 20, CV_8UC1, cv::Scalar(0)), OverlayOptions()),
            "overlay: camera front needs an 8-bit grey or BGR image of 640x480, not one of 20x10");
  EXPECT_NE(message(cv::Mat(480, 640, CV_16UC1, cv::Scalar(0)), OverlayOptions()), "");
  EXPECT_NE(message(cv::Mat(), OverlayOptions()), "");
  OverlayOptions inverted;
  inverted.min_range_m = 50.0;
  inverted.max_range_m = 20.0;
  EXPECT_NE(message(cv::Mat(480, 640, CV_8UC1, cv::Scalar(0)), inverted), "");
}

}  // namespace
}  // namespace scenecalib
