#include "../../src/calibration/feature_point_grid.h"

#include <gtest/gtest.h>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

FeaturePoint PointAt(const Eigen::Vector3d& point_in_map_m, std::vector<Timestamp> stamps_ns) {
  FeaturePoint point;
  point.point_in_map_m = point_in_map_m;
  point.stamps_ns = std::move(stamps_ns);
  return point;
}

TEST(FeaturePointGrid, GivesEachStampOnceAndInOrder) {
  const std::vector<FeaturePoint> points = {PointAt({1.0, 2.0, 0.0}, {30, 40}),
                                            PointAt({1.1, 2.0, 0.0}, {10, 30}),
                                            PointAt({9.0, 2.0, 0.0}, {50})};
  const FeaturePointGrid grid(points, 0.5);
  EXPECT_EQ(grid.StampsNear({1.0, 2.1, 0.0}), (std::vector<Timestamp>{10, 30, 40}));
  EXPECT_TRUE(grid.StampsNear({5.0, 2.0, 0.0}).empty());
}

TEST(FeaturePointGrid, FindsWhatIsWithinTheRadiusAcrossTheCells) {
  constexpr double kRadius_m = 0.4;
  Random random(5);
  const auto draw = [&random] {
    return Eigen::Vector3d(random.Uniform(-2, 2), random.Uniform(-2, 2), random.Uniform(-2, 2));
  };
  std::vector<FeaturePoint> points;
  for (Timestamp i = 0; i < 500; ++i) points.push_back(PointAt(draw(), {i}));
  const FeaturePointGrid grid(points, kRadius_m);
  std::size_t num_found = 0;
  for (int k = 0; k < 200; ++k) {
    const Eigen::Vector3d at = draw();
    std::vector<Timestamp> expected;
    for (const FeaturePoint& point : points) {
      if ((point.point_in_map_m - at).norm() <= kRadius_m) expected.push_back(point.stamps_ns[0]);
    }
    EXPECT_EQ(grid.StampsNear(at), expected);
    num_found += expected.size();
  }
  EXPECT_GT(num_found, 100U) << "something to find";
}

}  // namespace
}  // namespace scenecalib
