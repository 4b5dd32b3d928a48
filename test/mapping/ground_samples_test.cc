#include "../../src/mapping/ground_samples.h"

#include <gtest/gtest.h>

#include <cmath>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr float kKerbX_m = 1.03F;
constexpr float kKerb_m = 0.12F;

/// Returns of a road and a pavement, 1.5 per square centimetre, and of the kerb's face between.
std::vector<LidarReturn> Kerb(float noise_m) {
  Random random(1);
  std::vector<LidarReturn> points;
  for (int i = 0; i < 30000; ++i) {
    LidarReturn point;
    const auto x = static_cast<float>(random.Uniform(0.0, 2.0));
    const float z = x > kKerbX_m ? kKerb_m : 0.0F;
    point.position_m = {x, static_cast<float>(random.Uniform(0.0, 1.0)),
                        z + noise_m * static_cast<float>(random.Gaussian())};
    points.push_back(point);
    if (i % 20 != 0) continue;
    point.position_m.x() = kKerbX_m + noise_m * static_cast<float>(random.Gaussian());
    point.position_m.z() = static_cast<float>(random.Uniform(0.0, kKerb_m));
    points.push_back(point);
  }
  return points;
}

TEST(AverageGround, KeepsRoadAndPavementApartAtAKerb) {
  const std::vector<LidarReturn> points = Kerb(0.005F);
  const std::vector<PointLabel> labels(points.size(), PointLabel::kGround);
  const std::vector<GroundSample> samples = AverageGround(points, labels, 0.1);
  ASSERT_GT(samples.size(), 190u);
  int num_at_kerb = 0;
  for (const GroundSample& sample : samples) {
    const float level_m = sample.position_m.z() < 0.5F * kKerb_m ? 0.0F : kKerb_m;
    EXPECT_NEAR(sample.position_m.z(), level_m, 0.008F) << "at x " << sample.position_m.x();
    EXPECT_GT(sample.normal.z(), 0.995F) << "at x " << sample.position_m.x();
    num_at_kerb += std::abs(sample.position_m.x() - kKerbX_m) < 0.05F ? 1 : 0;
  }
  EXPECT_GT(num_at_kerb, 5);
}

TEST(AverageGround, TakesOnlyGround) {
  const std::vector<LidarReturn> points = Kerb(0.005F);
  const std::vector<PointLabel> labels(points.size(), PointLabel::kStructure);
  EXPECT_TRUE(AverageGround(points, labels, 0.1).empty());
}

}  // namespace
}  // namespace scenecalib
