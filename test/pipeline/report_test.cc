#include "scenecalib/pipeline/report.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <opencv2/imgcodecs.hpp>

#include "pipeline/one_camera_rig.h"
#include "scenecalib/base/timestamp.h"
#include "scenecalib/io/rig_yaml.h"

namespace scenecalib {
namespace {

constexpr Timestamp kSecond_ns = 1'000'000'000;
constexpr int kNearGrey = 200;
constexpr int kFarGrey = 40;

TEST(ReportPictures, OfTheCloudTakeColoursFromImagesNearThePlaceTheyShow) {
  // A kilometre at 10 m/s, an image every second. The picture shows what lies ahead of its middle.
  const Result<Rig> rig = ParseRig(kOneCameraRig, "test");
  ASSERT_TRUE(rig.ok()) << rig.status().message();
  PipelineResult result;
  result.initial_rig = *rig;
  result.calibration.result.rig = *rig;
  std::vector<TimedPose> poses;
  CameraSegment segment;
  for (int s = 0; s <= 100; ++s) {
    poses.push_back({s * kSecond_ns, Rigid3(Eigen::Quaterniond::Identity(), {10.0 * s, 0, 0})});
    const bool is_near = std::abs(s - 50) <= 5;
    segment.images[s * kSecond_ns] =
        cv::Mat(48, 64, CV_8UC1, cv::Scalar(is_near ? kNearGrey : kFarGrey));
  }
  result.segments = {segment};
  SceneMap& map = result.mapping.map;
  map.map_from_lidar = *Trajectory::Create(std::move(poses));
  for (int i = 0; i < 400; ++i) {  // a wall's foot on the left, 490 to 530 m along
    map.points.push_back(
        {Eigen::Vector3f(490.0F + 0.1F * static_cast<float>(i), 2.0F, 0.0F), 1.0F});
  }

  const Result<ReportData> data = MakeReportData(result, {});
  ASSERT_TRUE(data.ok()) << data.status().message();
  ASSERT_EQ(data->clouds.size(), 1u);
  const cv::Mat picture = cv::imdecode(data->clouds[0].after_jpeg, cv::IMREAD_GRAYSCALE);
  ASSERT_FALSE(picture.empty());
  int num_near = 0;
  int num_far = 0;
  for (int i = 0; i < picture.rows * picture.cols; ++i) {
    num_near += std::abs(picture.data[i] - kNearGrey) < 15 ? 1 : 0;
    num_far += std::abs(picture.data[i] - kFarGrey) < 15 ? 1 : 0;
  }
  EXPECT_GT(num_near, 500);
  EXPECT_LT(num_far, num_near / 20);
}

TEST(DescribeLasers, SaysWhatTheyWereCorrectedByOrThatTheyWereNot) {
  MappingReport report;
  EXPECT_EQ(DescribeLasers(report), "lasers: as the lidar reports them");
  report.laser_range_m = 4e-5;  // neither would show
  report.laser_elevation_rad = 5e-6;
  EXPECT_EQ(DescribeLasers(report), "lasers: as the lidar reports them");
  report.laser_elevation_rad = 2e-4;
  EXPECT_EQ(DescribeLasers(report), "lasers: corrected by 0.0 mm and 0.011 deg in elevation (RMS)");
  report.laser_range_m = 0.0128;
  EXPECT_EQ(DescribeLasers(report),
            "lasers: corrected by 12.8 mm and 0.011 deg in elevation (RMS)");
}

}  // namespace
}  // namespace scenecalib
