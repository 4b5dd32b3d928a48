#include "../../src/mapping/height_correction.h"

#include <gtest/gtest.h>

#include <cmath>

namespace scenecalib {
namespace {

/// The true ground: a slope.
float Height(float x) { return 0.05F * x; }

TEST(CorrectHeights, BringsAWavingSurfaceBackToItsData) {
  const Eigen::Vector3f normal = Eigen::Vector3f(-0.05F, 0.0F, 1.0F).normalized();
  std::vector<GroundSample> samples;
  TriangleMesh surface;
  for (int i = 0; i < 100; ++i) {
    for (int j = 0; j < 50; ++j) {
      const float x = 0.1F * static_cast<float>(i);
      const float y = 0.1F * static_cast<float>(j);
      samples.push_back({Eigen::Vector3f(x, y, Height(x)), normal});
      const float wave_m = 0.002F + 0.003F * std::sin(0.6F * x);  // much longer than the 1 m window
      surface.vertices_m.push_back({x + 0.03F, y, Height(x + 0.03F) + wave_m});
    }
  }
  CorrectHeights(samples, &surface);
  for (const Eigen::Vector3f& vertex_m : surface.vertices_m) {
    EXPECT_NEAR(vertex_m.z(), Height(vertex_m.x()), 0.0006F);
  }
}

TEST(CorrectHeights, LeavesVerticesWithoutDataAndStepsAlone) {
  std::vector<GroundSample> samples;
  for (int i = 0; i < 20; ++i) {
    // A kerb's face beside the surface, and flat data too far above it.
    samples.push_back(
        {Eigen::Vector3f(0.1F * static_cast<float>(i), 0.0F, 0.01F), Eigen::Vector3f::UnitY()});
    samples.push_back(
        {Eigen::Vector3f(0.1F * static_cast<float>(i), 0.0F, 0.12F), Eigen::Vector3f::UnitZ()});
  }
  TriangleMesh surface;
  surface.vertices_m = {{0.5F, 0.0F, 0.0F}, {1.0F, 0.1F, 0.0F}, {30.0F, 0.0F, 0.0F}};
  CorrectHeights(samples, &surface);
  for (const Eigen::Vector3f& vertex_m : surface.vertices_m) EXPECT_EQ(vertex_m.z(), 0.0F);
}

}  // namespace
}  // namespace scenecalib
