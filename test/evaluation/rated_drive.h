#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <opencv2/core.hpp>
#include <vector>

#include "evaluation_fixture.h"
#include "scenecalib/evaluation/miscalibration_rate.h"
#include "scenecalib/sensor/image_pose.h"

namespace scenecalib {

/// A drive along x between a wall on the left, ground below and a wall ahead, all with a texture.
class RatedDrive : public ::testing::Test {
 protected:
  void SetUp() override {
    std::vector<TimedPose> poses;
    for (int i = 0; i <= 20; ++i) {
      poses.push_back({i * 100000000LL, Rigid3(ExpSo3({0.0, 0.0, 0.01 * i}), {0.3 * i, 0.0, 0.0})});
    }
    map_.map_from_lidar = Trajectory::Create(poses).value();
    AddQuad({-1.0, 4.0, -1.7}, {21.0, 0.0, 0.0}, {0.0, 0.0, 9.0});    // left
    AddQuad({-1.0, -6.0, -1.7}, {21.0, 0.0, 0.0}, {0.0, 10.0, 0.0});  // ground
    AddQuad({20.0, -6.0, -1.7}, {0.0, 10.0, 0.0}, {0.0, 0.0, 9.0});   // ahead
    rig_ = RigOf({ForwardCamera("front")});
    rig_.cameras[0].model = *CreateCameraModel(
        {"ftheta", 240, 180, {}, {119.5, 89.5}, {150.0, 0.0, 0.0, 0.0, 0.0}, {}});
    for (const Timestamp stamp_ns : {300000000LL, 800000000LL, 1100000000LL, 1600000000LL}) {
      images_[stamp_ns] = Render(stamp_ns);
    }
    options_.num_times = 4;
    options_.num_samples = 30;
    options_.max_points = 3000;  // of four times where a recording has twenty
  }

  void AddQuad(const Eigen::Vector3d& corner_m, const Eigen::Vector3d& u,
               const Eigen::Vector3d& v) {
    TriangleMesh& mesh = map_.ground;
    const int first = static_cast<int>(mesh.vertices_m.size());
    for (const Eigen::Vector3d& at :
         {corner_m, Eigen::Vector3d(corner_m + u), Eigen::Vector3d(corner_m + u + v),
          Eigen::Vector3d(corner_m + v)}) {
      mesh.vertices_m.push_back(at.cast<float>());
    }
    mesh.triangles.push_back({first, first + 1, first + 2});
    mesh.triangles.push_back({first, first + 2, first + 3});
  }

  static double Texture(const Eigen::Vector3d& p) {
    // Patterns of a metre and of a third of that: the latter are some 10 px wide.
    return 128.0 + 30.0 * std::sin(6.1 * p.x() + 5.3 * p.y() * p.z()) +
           40.0 * std::sin(14.7 * p.z() - 12.9 * p.x()) * std::cos(13.9 * p.y());
  }

  /// Exact: the first of the three planes that a pixel's ray meets.
  cv::Mat Render(Timestamp stamp_ns) const {
    const CameraConfig& camera = rig_.cameras[0];
    const ImagePose pose = *ImagePoseOf(camera, map_.map_from_lidar, stamp_ns);
    cv::Mat image(camera.model->height_px(), camera.model->width_px(), CV_8UC1, cv::Scalar(0));
    for (int y = 0; y < image.rows; ++y) {
      const Rigid3 map_from_camera = pose.At(y);
      for (int x = 0; x < image.cols; ++x) {
        const Eigen::Vector3d& origin = map_from_camera.translation;
        const Eigen::Vector3d ray =
            map_from_camera.rotation * *camera.model->Unproject(Eigen::Vector2d(x, y));
        const double ranges_m[] = {(20.0 - origin.x()) / ray.x(), (4.0 - origin.y()) / ray.y(),
                                   (-1.7 - origin.z()) / ray.z()};
        double nearest_m = 1e3;
        for (const double range_m : ranges_m) {
          if (range_m > 0.0) nearest_m = std::min(nearest_m, range_m);
        }
        image.at<unsigned char>(y, x) =
            static_cast<unsigned char>(std::lround(Texture(origin + nearest_m * ray)));
      }
    }
    return image;
  }

  SceneMap map_;
  Rig rig_;
  std::map<Timestamp, cv::Mat> images_;
  MiscalibrationOptions options_;
};

}  // namespace scenecalib
