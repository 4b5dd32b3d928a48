#include "scenecalib/mapping/packed_scan.h"

#include <gtest/gtest.h>

#include <limits>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr double kMinRangeM = 2.0;
constexpr double kMaxRangeM = 120.0;

LidarScan ScatteredScan(int num_points) {
  Random random(3);
  LidarScan scan;
  scan.stamp_ns = 1700000000123456789;
  for (int i = 0; i < num_points; ++i) {
    LidarPoint point;
    const Eigen::Vector3d direction(random.Gaussian(), random.Gaussian(), random.Gaussian());
    point.position_in_lidar_m =
        (random.Uniform(kMinRangeM + 0.1, kMaxRangeM - 0.1) * direction.normalized()).cast<float>();
    point.time_offset_s = static_cast<float>(random.Uniform(-0.05, 0.05));
    point.intensity = static_cast<float>(random.Uniform(0.0, 255.0));
    scan.points.push_back(point);
  }
  return scan;
}

TEST(PackedScan, GivesBackWhatItTookToItsResolution) {
  const LidarScan scan = ScatteredScan(1000);
  const PackedScan packed(scan, kMinRangeM, kMaxRangeM);
  EXPECT_EQ(packed.stamp_ns(), scan.stamp_ns);
  ASSERT_EQ(packed.size(), scan.points.size());
  EXPECT_EQ(packed.num_bytes(), 12000U);
  for (std::size_t i = 0; i < packed.size(); ++i) {
    const LidarPoint& point = scan.points[i];
    // Half a step per axis, and single precision.
    EXPECT_LT((packed.position_in_lidar_m(i) - point.position_in_lidar_m).cwiseAbs().maxCoeff(),
              0.07e-3);
    EXPECT_NEAR(packed.time_offset_s(i), point.time_offset_s, 1e-6);
    EXPECT_NEAR(packed.intensity(i), point.intensity, 3e-3);
  }
}

TEST(PackedScan, DropsWhatIsTooNearTooFarOrNotFinite) {
  LidarScan scan = ScatteredScan(4);
  scan.points[0].position_in_lidar_m = {0.0F, 1.9F, 0.0F};
  scan.points[1].position_in_lidar_m = {0.0F, -120.1F, 0.0F};
  scan.points[2].position_in_lidar_m.z() = std::numeric_limits<float>::quiet_NaN();
  const PackedScan packed(scan, kMinRangeM, kMaxRangeM);
  ASSERT_EQ(packed.size(), 1U);
  EXPECT_LT((packed.position_in_lidar_m(0) - scan.points[3].position_in_lidar_m).norm(), 1e-3);
}

TEST(PackedScan, HoldsTheFarthestPointsOfEveryAxis) {
  LidarScan scan;
  for (int axis = 0; axis < 3; ++axis) {
    for (const float sign : {-1.0F, 1.0F}) {
      LidarPoint point;
      point.position_in_lidar_m[axis] = sign * static_cast<float>(kMaxRangeM);
      scan.points.push_back(point);
    }
  }
  const PackedScan packed(scan, kMinRangeM, kMaxRangeM);
  ASSERT_EQ(packed.size(), scan.points.size());
  for (std::size_t i = 0; i < packed.size(); ++i) {
    EXPECT_LT((packed.position_in_lidar_m(i) - scan.points[i].position_in_lidar_m).norm(), 2e-4);
    EXPECT_EQ(packed.time_offset_s(i), 0.0F);
  }
}

TEST(PackedScan, TakesAnEmptyScan) {
  EXPECT_EQ(PackedScan(LidarScan(), kMinRangeM, kMaxRangeM).size(), 0U);
}

}  // namespace
}  // namespace scenecalib
