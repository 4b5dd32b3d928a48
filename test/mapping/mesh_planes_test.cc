#include "../../src/mapping/mesh_planes.h"

#include <gtest/gtest.h>

#include <cmath>

namespace scenecalib {
namespace {

/// A grid of triangles, `height(x, y)` above the plane z = 0.
template <typename Height>
TriangleMesh Road(const Height& height) {
  constexpr double kCell_m = 0.1;
  constexpr int kColumns = 60;
  constexpr int kRows = 100;
  TriangleMesh mesh;
  for (int i = 0; i <= kRows; ++i) {
    for (int j = 0; j <= kColumns; ++j) {
      const double x = kCell_m * i;
      const double y = kCell_m * (j - kColumns / 2);
      mesh.vertices_m.push_back(Eigen::Vector3d(x, y, height(x, y)).cast<float>());
    }
  }
  for (int i = 0; i < kRows; ++i) {
    for (int j = 0; j < kColumns; ++j) {
      const int k = i * (kColumns + 1) + j;
      mesh.triangles.push_back({k, k + kColumns + 1, k + 1});
      mesh.triangles.push_back({k + 1, k + kColumns + 1, k + kColumns + 2});
    }
  }
  return mesh;
}

TEST(FitMeshPlanes, OnACamberedRoadThePlanesGoThroughTheRoad) {
  // 2 cm of camber over 3 m: a plane fitted over 3 m lies 1.6 mm below the middle of its square.
  const auto camber = [](double, double y) { return -0.02 * (y / 3.0) * (y / 3.0); };
  const TriangleMesh mesh = Road(camber);
  const std::vector<MeshPlane> planes = FitMeshPlanes(mesh);
  int num_wide = 0;
  for (std::size_t i = 0; i < planes.size(); ++i) {
    Eigen::Vector3d centroid = Eigen::Vector3d::Zero();
    for (const int k : mesh.triangles[i]) centroid += mesh.vertices_m[k].cast<double>() / 3.0;
    const MeshPlane& plane = planes[i];
    if (std::abs(centroid.y()) > 2.0) continue;  // the mesh ends at 3 m
    EXPECT_NEAR(plane.normal.dot(centroid - plane.point_m), 0.0, 4e-4);
    if (plane.planar && plane.scale_m > 2.0) ++num_wide;
  }
  EXPECT_GT(num_wide, static_cast<int>(planes.size()) / 3) << "wide planes still stand for it";
}

TEST(FitMeshPlanes, NormalsAreThoseOfMetresAroundNotOfOneTriangle) {
  // Ripples of 1 mm, which tilt single triangles by a degree.
  const auto ripples = [](double x, double y) { return 1e-3 * std::sin(31.0 * x + 47.0 * y); };
  int num_planar = 0;
  for (const MeshPlane& plane : FitMeshPlanes(Road(ripples))) {
    if (!plane.planar) continue;
    ++num_planar;
    EXPECT_GT(plane.normal.z(), std::cos(0.004));
  }
  EXPECT_GT(num_planar, 0);
}

TEST(FitMeshPlanes, AnEmptyMeshHasNoPlanes) { EXPECT_TRUE(FitMeshPlanes({}).empty()); }

}  // namespace
}  // namespace scenecalib
