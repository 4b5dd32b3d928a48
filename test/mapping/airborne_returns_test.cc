#include "../../src/mapping/airborne_returns.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

/// What a beam of a street between two walls meets: walls 8 m to both sides, road 1.9 m below.
float RangeInStreet(const Eigen::Vector3f& ray) {
  float range_m = 60.0F;
  if (std::abs(ray.y()) > 1e-3F) range_m = std::min(range_m, 8.0F / std::abs(ray.y()));
  if (ray.z() < -1e-3F) range_m = std::min(range_m, 1.9F / -ray.z());
  return range_m;
}

/// A turn of a lidar of 64 rings; `range_of` gives each beam's range, 0 for no return.
PackedScan Cast(const std::function<float(const Eigen::Vector3f&)>& range_of) {
  LidarScan scan;
  for (int ring = 0; ring < 64; ++ring) {
    const float elevation = (-25.0F + 40.0F * static_cast<float>(ring) / 63.0F) * 0.01745329F;
    for (int column = 0; column < 1024; ++column) {
      const float azimuth = 6.2831853F * static_cast<float>(column) / 1024.0F;
      const Eigen::Vector3f ray(std::cos(elevation) * std::cos(azimuth),
                                std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      const float range_m = range_of(ray);
      if (range_m <= 0.0F) continue;
      LidarPoint point;
      point.position_in_lidar_m = range_m * ray;
      scan.points.push_back(point);
    }
  }
  return PackedScan(scan, 1.0, 120.0);
}

constexpr double kClear = 0.005;

TEST(AirborneShare, IsNoneInAStreet) { EXPECT_LT(AirborneShare(Cast(RangeInStreet)), kClear); }

TEST(AirborneShare, GrowsWithTheFlakesInTheAir) {
  double last = kClear;
  for (const double share : {0.05, 0.1, 0.25, 0.5}) {
    Random random(3);
    const double found = AirborneShare(Cast([&](const Eigen::Vector3f& ray) {
      const auto flake_m = static_cast<float>(2.0 - 4.3 * std::log(1.0 - random.Uniform()));
      const float range_m = RangeInStreet(ray);
      return random.Uniform() < share ? std::min(flake_m, range_m) : range_m;
    }));
    EXPECT_GT(found, last) << share;
    EXPECT_GT(found, 0.4 * share);  // most flakes are near, some before a wall hardly behind them
    EXPECT_LT(found, share);
    last = found;
  }
}

TEST(AirborneShare, OfLeavesStaysFarBelowThatOfSnow) {
  // A crown 2 m deep all along one side: leaves of 10 cm, two thirds of the beams end in it.
  Random random(5);
  const double found = AirborneShare(Cast([&](const Eigen::Vector3f& ray) {
    const float range_m = RangeInStreet(ray);
    if (ray.y() < 0.3F || ray.z() < 0.0F || random.Uniform() > 0.66) return range_m;
    return std::min(range_m, 4.0F + 2.0F * static_cast<float>(random.Uniform()));
  }));
  EXPECT_LT(found, 0.03);  // every beam's range is drawn for itself: looser than any tree
}

TEST(AirborneShare, CountsNoFence) {
  // Bars of 3 cm every 13 cm, 5 m to the left.
  const double found = AirborneShare(Cast([](const Eigen::Vector3f& ray) {
    const float range_m = RangeInStreet(ray);
    if (ray.y() < 0.1F) return range_m;
    const float fence_m = 5.0F / ray.y();
    const Eigen::Vector3f at = fence_m * ray;
    const float phase = at.x() / 0.13F - std::floor(at.x() / 0.13F);
    return std::abs(at.z() + 0.9F) < 1.0F && phase < 0.23F ? std::min(range_m, fence_m) : range_m;
  }));
  EXPECT_LT(found, 4.0 * kClear);
}

TEST(AirborneShare, IsZeroWithoutReturns) { EXPECT_EQ(AirborneShare(PackedScan()), 0.0); }

}  // namespace
}  // namespace scenecalib
