#include "../../src/mapping/surfel_fit.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr float kNoise_m = 0.02F;
constexpr float kWallX_m = 8.0F;
constexpr float kWallHalfWidth_m = 2.1F;
constexpr float kWallHeight_m = 3.1F;

/// Returns of a lidar that stands at the origin.
class Returns {
 public:
  explicit Returns(int seed) : random_(seed) {}

  void Add(const Eigen::Vector3f& true_point_m) {
    LidarReturn point;
    const float noise_m = kNoise_m * static_cast<float>(random_.Gaussian());
    point.position_m = true_point_m + noise_m * true_point_m.normalized();
    points_.push_back(point);
  }
  void AddWall(int count) {
    for (int i = 0; i < count; ++i) {
      Add({kWallX_m, Uniform(-kWallHalfWidth_m, kWallHalfWidth_m), Uniform(-1.0F, kWallHeight_m)});
    }
  }
  /// Leaves all over a ball.
  void AddTree(const Eigen::Vector3f& center_m, float radius_m, int count) {
    for (int i = 0; i < count;) {
      const Eigen::Vector3f offset_m(Uniform(-radius_m, radius_m), Uniform(-radius_m, radius_m),
                                     Uniform(-radius_m, radius_m));
      if (offset_m.norm() > radius_m) continue;
      Add(center_m + offset_m);
      ++i;
    }
  }
  float Uniform(float low, float high) { return static_cast<float>(random_.Uniform(low, high)); }

  std::vector<Surfel> Fit() const {
    return FitSurfels(points_, std::vector<PointLabel>(points_.size(), PointLabel::kStructure), {7},
                      SurfelOptions());
  }

 private:
  Random random_;
  std::vector<LidarReturn> points_;
};

int CountPlanar(const std::vector<Surfel>& surfels) {
  return static_cast<int>(
      std::count_if(surfels.begin(), surfels.end(), [](const Surfel& s) { return s.planar; }));
}

/// Whether a disc of the kind asked for covers a point of the wall.
bool WallIsCovered(const std::vector<Surfel>& surfels, float y_m, float z_m, bool planar) {
  return std::any_of(surfels.begin(), surfels.end(), [&](const Surfel& surfel) {
    return surfel.planar == planar &&
           std::hypot(surfel.center_m.y() - y_m, surfel.center_m.z() - z_m) < surfel.radius_m;
  });
}

TEST(FitSurfels, PlanarDiscsEndWhereTheWallEndsAndARimSurroundsThem) {
  Returns returns(1);
  returns.AddWall(30000);
  const std::vector<Surfel> surfels = returns.Fit();
  ASSERT_GT(CountPlanar(surfels), 20);
  float reach_m = 0.0F;
  bool has_rim = false;
  for (const Surfel& surfel : surfels) {
    if (surfel.planar) {
      EXPECT_NEAR(surfel.center_m.x(), kWallX_m, 0.01F);
      EXPECT_LT(surfel.normal.x(), -0.99F) << "towards the sensor";
      EXPECT_EQ(surfel.first_seen_ns, 7);
      reach_m = std::max(reach_m, std::abs(surfel.center_m.y()) + surfel.radius_m);
    } else if (surfel.center_m.x() > kWallX_m + 0.005F && surfel.thickness_m < 2.0F * kNoise_m) {
      has_rim = true;
    }
  }
  // Noise and the reach of an inscribed disc: a centimetre, not half a disc.
  EXPECT_LT(reach_m, kWallHalfWidth_m + 0.03F);
  EXPECT_TRUE(has_rim);
}

TEST(FitSurfels, AWallWithoutGapsIsPlanarEverywhereInside) {
  Returns returns(2);
  returns.AddWall(30000);
  const std::vector<Surfel> surfels = returns.Fit();
  int num_covered = 0;
  constexpr int kTrials = 500;
  for (int i = 0; i < kTrials; ++i) {
    num_covered +=
        WallIsCovered(surfels, returns.Uniform(-1.8F, 1.8F), returns.Uniform(-0.7F, 2.8F), true);
  }
  EXPECT_GT(num_covered, 0.97 * kTrials);
}

TEST(FitSurfels, FoliageOccludesButIsNoPlane) {
  Returns returns(3);
  returns.AddWall(30000);
  const int num_planar_of_wall = CountPlanar(returns.Fit());
  returns.AddTree({5.0F, 6.0F, 2.0F}, 1.3F, 8000);
  const std::vector<Surfel> surfels = returns.Fit();
  const int num_planar_of_tree = CountPlanar(surfels) - num_planar_of_wall;
  const int num_of_tree =
      static_cast<int>(std::count_if(surfels.begin(), surfels.end(), [](const Surfel& s) {
        return s.center_m.y() > kWallHalfWidth_m + 1.0F;
      }));
  EXPECT_GT(num_of_tree, 300);
  EXPECT_LT(num_planar_of_tree, 0.04 * num_of_tree);
}

TEST(FitSurfels, ThinFoliageStillOccludes) {
  Returns returns(4);
  returns.AddWall(30000);
  // 17 leaves in a cubic metre: hardly two in any finest voxel.
  returns.AddTree({5.0F, 6.0F, 2.0F}, 0.4F, 40);
  const std::vector<Surfel> surfels = returns.Fit();
  float area_m2 = 0.0F;
  for (const Surfel& surfel : surfels) {
    if (surfel.center_m.y() < kWallHalfWidth_m + 1.0F) continue;
    EXPECT_FALSE(surfel.planar);
    area_m2 += static_cast<float>(M_PI) * surfel.radius_m * surfel.radius_m;
  }
  EXPECT_GT(area_m2, 0.2F) << "of the 0.5 square metres that the crown takes up";
}

TEST(FitSurfels, AFewStrayReturnsBeforeAWallAreNoOccluder) {
  Returns returns(5);
  returns.AddWall(30000);
  for (int i = 0; i < 60; ++i) {
    returns.Add({kWallX_m - 0.09F, returns.Uniform(-1.5F, 1.5F), returns.Uniform(-0.5F, 2.5F)});
  }
  const std::vector<Surfel> surfels = returns.Fit();
  for (const Surfel& surfel : surfels) {
    EXPECT_TRUE(surfel.planar || surfel.center_m.x() > kWallX_m - 0.05F ||
                std::abs(surfel.center_m.y()) > 1.8F)
        << "at " << surfel.center_m.transpose();
  }
}

}  // namespace
}  // namespace scenecalib
