#include "scenecalib/calibration/trajectory_correction.h"

#include <gtest/gtest.h>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr Timestamp kStart = 1700000000000000000;

TEST(TrajectoryCorrection, IsLinearBetweenKnotsAndConstantBeyondThem) {
  TrajectoryCorrection correction(kStart, AddSeconds(kStart, 1.0), 0.5);
  ASSERT_EQ(correction.knots().size(), 3U);
  correction.knots()[1][4] = 0.2;
  EXPECT_NEAR(correction.At(AddSeconds(kStart, 0.25))[4], 0.1, 1e-12);
  EXPECT_NEAR(correction.At(AddSeconds(kStart, 0.5))[4], 0.2, 1e-12);
  EXPECT_NEAR(correction.At(AddSeconds(kStart, 0.75))[4], 0.1, 1e-12);
  correction.knots()[2][4] = 0.3;
  EXPECT_NEAR(correction.At(AddSeconds(kStart, 7.0))[4], 0.3, 1e-12);
  EXPECT_NEAR(correction.At(AddSeconds(kStart, -7.0))[4], 0.0, 1e-12);
}

TEST(TrajectoryCorrection, ActsInTheLidarFrame) {
  TrajectoryCorrection correction(kStart, AddSeconds(kStart, 1.0), 0.5);
  for (Vector6d& knot : correction.knots()) knot << 0.0, 0.0, 0.1, 1.0, 0.0, 0.0;
  const Rigid3 map_from_lidar(ExpSo3({0.0, 0.0, 1.5707963267948966}), {5.0, 0.0, 0.0});
  const Rigid3 corrected = correction.Apply(map_from_lidar, kStart);
  // One metre forward of a lidar that looks along y of the map.
  EXPECT_LT((corrected.translation - Eigen::Vector3d(5.0, 1.0, 0.0)).norm(), 1e-12);
  EXPECT_NEAR(RotationAngle(map_from_lidar.rotation, corrected.rotation), 0.1, 1e-12);
}

TEST(TrajectoryCorrection, WithoutKnotsChangesNothing) {
  const TrajectoryCorrection none;
  const Rigid3 pose(ExpSo3({0.1, 0.2, 0.3}), {1.0, 2.0, 3.0});
  EXPECT_EQ(none.Apply(pose, kStart).translation, pose.translation);
  EXPECT_EQ(none.At(TrajectoryCorrection::Place()), Vector6d(Vector6d::Zero()));
}

}  // namespace
}  // namespace scenecalib
