#include "scenecalib/pipeline/overlays.h"

#include <gtest/gtest.h>

#include "pipeline/one_camera_rig.h"
#include "scenecalib/base/timestamp.h"
#include "scenecalib/io/rig_yaml.h"

namespace scenecalib {
namespace {

constexpr Timestamp kSecond_ns = 1'000'000'000;

/// 10 m/s along x, an image every second whose grey values are the seconds.
class ColourMapTest : public testing::Test {
 protected:
  ColourMapTest() {
    const Result<Rig> rig = ParseRig(kOneCameraRig, "test");
    EXPECT_TRUE(rig.ok()) << rig.status().message();
    rig_ = *rig;
    std::vector<TimedPose> poses;
    CameraSegment segment;
    for (int s = 0; s <= 100; ++s) {
      poses.push_back({s * kSecond_ns, Rigid3(Eigen::Quaterniond::Identity(), {10.0 * s, 0, 0})});
      segment.images[s * kSecond_ns] = cv::Mat(48, 64, CV_8UC1, cv::Scalar(s));
    }
    map_.map_from_lidar = *Trajectory::Create(std::move(poses));
    segments_.push_back(segment);
    for (int x = 0; x < 1000; ++x) {  // a point every metre: its index is its x
      map_.points.push_back({Eigen::Vector3f(static_cast<float>(x), 2.0F, 1.0F), 1.0F});
    }
  }

  Rig rig_;
  SceneMap map_;
  std::vector<CameraSegment> segments_;
};

TEST_F(ColourMapTest, TheNearestSightingCounts) {
  const std::vector<int> colours = ColourMap(rig_, map_, segments_, 1000);
  // From the last place that had it ahead in the image, more than 2.5 m away.
  EXPECT_EQ(colours[504], 0x010101 * 50);
  EXPECT_EQ(colours[501], 0x010101 * 49);
}

TEST_F(ColourMapTest, TakesImagesOfTheWindowOnly) {
  const std::vector<int> colours =
      ColourMap(rig_, map_, segments_, 1000, {40 * kSecond_ns, 42 * kSecond_ns});
  EXPECT_EQ(colours[405], 0x010101 * 40);
  EXPECT_EQ(colours[460], 0x010101 * 42);
  EXPECT_EQ(colours[395], -1) << "behind all of them";
}

TEST_F(ColourMapTest, ALongDriveNeedsMoreImages) {
  EXPECT_EQ(NumImagesForColour(*Trajectory::Create({{0, Rigid3()}, {kSecond_ns, Rigid3()}})), 12);
  EXPECT_EQ(
      NumImagesForColour(*Trajectory::Create(
          {{0, Rigid3()}, {kSecond_ns, Rigid3(Eigen::Quaterniond::Identity(), {300, 0, 0})}})),
      20);
  EXPECT_EQ(NumImagesForColour(map_.map_from_lidar), 48) << "of a kilometre: the bound";
}

}  // namespace
}  // namespace scenecalib
