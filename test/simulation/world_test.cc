#include "scenecalib/simulation/world.h"

#include <gtest/gtest.h>

#include <string>

namespace scenecalib {
namespace {

struct Figures {
  std::size_t num_triangles, num_surfaces, num_shadow_triangles;
  double vertex_sum_m;  ///< over all coordinates of all vertices
};

Figures FiguresOf(const std::string& kind) {
  const Random random(1);
  const RoadCurve road("turns", -70.0, 90.0, 150.0, CornerRadius(kind), random.Fork(0));
  SimulatedWorldOptions options;
  options.kind = kind;
  const World world = BuildWorld(options, road, 8.0, random.Fork(1));
  double sum_m = 0.0;
  for (const Eigen::Vector3f& v : world.mesh.vertices()) sum_m += v.cast<double>().sum();
  return {world.mesh.num_triangles(), world.mesh.surfaces().size(),
          world.shadow_mesh.num_triangles(), sum_m};
}

// Figures that others have measured rest on these worlds: they must not change. The sum may differ
// by rounding between C libraries; another draw of a random number anywhere changes it by metres.
TEST(World, IsTheSameFromVersionToVersion) {
  const struct {
    const char* kind;
    Figures expected;
  } kPinned[] = {
      {"street", {112980, 1449, 2816, -6566404.57}},
      {"suburb", {145328, 1316, 4504, -4342019.87}},
      {"plaza", {123786, 1578, 2960, -500670.66}},
      {"industrial", {79706, 501, 752, -1128053.45}},
      {"avenue", {567726, 1699, 13088, -9825694.97}},
      {"village", {58784, 802, 808, -4128010.56}},
  };
  for (const auto& [kind, expected] : kPinned) {
    const Figures figures = FiguresOf(kind);
    EXPECT_EQ(figures.num_triangles, expected.num_triangles) << kind;
    EXPECT_EQ(figures.num_surfaces, expected.num_surfaces) << kind;
    EXPECT_EQ(figures.num_shadow_triangles, expected.num_shadow_triangles) << kind;
    EXPECT_NEAR(figures.vertex_sum_m, expected.vertex_sum_m, 0.1) << kind;
  }
}

TEST(World, NamesTheKnownKindsInOneLineForAnUnknownOne) {
  EXPECT_TRUE(CheckWorldKind("village").ok());
  const Status status = CheckWorldKind("moon");
  EXPECT_EQ(status.code(), Status::Code::kInvalidArgument);
  EXPECT_EQ(
      status.message(),
      "world.kind is 'moon'; known are street, suburb, plaza, industrial, avenue and village");
}

}  // namespace
}  // namespace scenecalib
