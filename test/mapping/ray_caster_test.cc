#include "scenecalib/mapping/ray_caster.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

/// Embree works in single precision; the hit is recomputed in double on the surface's plane.
constexpr double kTolerance_m = 1e-5;

/// A flat road (x, y in [-10, 10]) of 20 cm cells at the given slope, with height noise.
TriangleMesh Road(double slope, double noise_m) {
  constexpr int kCells = 100;
  Random random(1);
  TriangleMesh mesh;
  for (int i = 0; i <= kCells; ++i) {
    for (int j = 0; j <= kCells; ++j) {
      const double x = -10.0 + 0.2 * i;
      const double y = -10.0 + 0.2 * j;
      mesh.vertices_m.push_back(
          Eigen::Vector3d(x, y, slope * x + noise_m * random.Gaussian()).cast<float>());
    }
  }
  for (int i = 0; i < kCells; ++i) {
    for (int j = 0; j < kCells; ++j) {
      const int k = i * (kCells + 1) + j;
      mesh.triangles.push_back({k, k + kCells + 1, k + 1});
      mesh.triangles.push_back({k + 1, k + kCells + 1, k + kCells + 2});
    }
  }
  return mesh;
}

Surfel Disc(const Eigen::Vector3f& center_m, const Eigen::Vector3f& normal, float radius_m) {
  Surfel surfel;
  surfel.center_m = center_m;
  surfel.normal = normal.normalized();
  surfel.radius_m = radius_m;
  surfel.scale_m = 1.6F;
  surfel.thickness_m = 0.02F;
  return surfel;
}

Ray RayTo(const Eigen::Vector3d& origin_m, const Eigen::Vector3d& target_m) {
  return {origin_m, (target_m - origin_m).normalized()};
}

TEST(RayCaster, RefusesAMapWithoutSurfaces) {
  const auto caster = RayCaster::Create(SceneMap());
  ASSERT_FALSE(caster.ok());
  EXPECT_EQ(caster.status().code(), Status::Code::kInsufficientData);
}

TEST(RayCaster, MeetsTheGroundWhereTheRayDoes) {
  SceneMap map;
  map.ground = Road(0.1, 0.0);
  const auto caster = RayCaster::Create(map);
  ASSERT_TRUE(caster.ok());
  const Eigen::Vector3d target_m(3.03, 1.07, 0.303);
  const auto hit = caster->Cast(RayTo({0.0, 0.0, 2.0}, target_m), 50.0);
  ASSERT_TRUE(hit.has_value());
  EXPECT_EQ(hit->kind, SurfaceKind::kGround);
  EXPECT_NEAR((hit->point_in_map_m - target_m).norm(), 0.0, kTolerance_m);
  EXPECT_NEAR(hit->normal_in_map.dot(Eigen::Vector3d(-0.1, 0.0, 1.0).normalized()), 1.0, 1e-9);
  EXPECT_TRUE(hit->planar);
  EXPECT_GE(hit->scale_m, 2.9);
  EXPECT_NEAR(hit->range_m, (target_m - Eigen::Vector3d(0.0, 0.0, 2.0)).norm(), kTolerance_m);
}

TEST(RayCaster, SmoothsTheNoiseOfTheMeshOverItsPlanarNeighbourhood) {
  SceneMap map;
  map.ground = Road(0.0, 0.004);
  const auto caster = RayCaster::Create(map);
  ASSERT_TRUE(caster.ok());
  Random random(2);
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d target_m(random.Uniform(-8.0, 8.0), random.Uniform(-8.0, 8.0), 0.0);
    const auto hit = caster->Cast(RayTo({0.0, 0.0, 3.0}, target_m), 50.0);
    ASSERT_TRUE(hit.has_value());
    EXPECT_TRUE(hit->planar);
    // 4 mm of noise on a 20 cm cell tilts a triangle by more than 1 degree; a plane over 3 m has
    // a tenth of the height noise and hardly a tilt.
    EXPECT_LT(std::abs(hit->point_in_map_m.z()), 0.002);
    EXPECT_GT(hit->normal_in_map.z(), std::cos(0.003));
    EXPECT_NEAR(hit->thickness_m, 0.004, 0.0015);
  }
}

TEST(RayCaster, TakesNoPlaneAcrossAKerb) {
  SceneMap map;
  map.ground = Road(0.0, 0.0);
  for (Eigen::Vector3f& vertex : map.ground.vertices_m) {
    if (vertex.y() > 0.01F) vertex.z() = 0.12F;
  }
  const auto caster = RayCaster::Create(map);
  ASSERT_TRUE(caster.ok());
  for (const double y : {-3.0, -1.0, -0.45, 0.7, 1.0, 3.0}) {
    const auto hit = caster->Cast(RayTo({0.0, y, 3.0}, {0.5, y, 0.0}), 50.0);
    ASSERT_TRUE(hit.has_value());
    EXPECT_NEAR(hit->point_in_map_m.z(), y > 0.0 ? 0.12 : 0.0, 0.012) << "at y = " << y;
  }
  const auto face = caster->Cast(RayTo({0.0, -1.0, 1.0}, {0.1, 0.1, 0.06}), 50.0);
  ASSERT_TRUE(face.has_value());
  EXPECT_FALSE(face->planar);
}

TEST(RayCaster, ReportsTheNearestOfGroundAndSurfels) {
  SceneMap map;
  map.ground = Road(0.0, 0.0);
  map.surfels = {Disc({6.0F, 0.0F, 1.0F}, {-1.0F, 0.0F, 0.0F}, 0.8F),
                 Disc({4.0F, 0.0F, 1.0F}, {1.0F, 0.2F, 0.0F}, 0.5F)};
  map.surfels[1].planar = false;
  const auto caster = RayCaster::Create(map);
  ASSERT_TRUE(caster.ok());
  const auto hit = caster->Cast(RayTo({0.0, 0.0, 1.0}, {6.0, 0.0, 1.0}), 50.0);
  ASSERT_TRUE(hit.has_value());
  EXPECT_EQ(hit->kind, SurfaceKind::kSurfel);
  EXPECT_EQ(hit->index, 1);
  EXPECT_FALSE(hit->planar);
  EXPECT_NEAR(hit->range_m, 4.0, kTolerance_m);
  EXPECT_LT(hit->normal_in_map.x(), 0.0) << "the normal looks against the ray";
  EXPECT_NEAR(hit->incidence_angle_rad, std::atan(0.2), 1e-6);
  EXPECT_FLOAT_EQ(static_cast<float>(hit->thickness_m), 0.02F);

  const auto above = caster->Cast(RayTo({0.0, 0.0, 1.0}, {6.0, 0.0, 1.78}), 50.0);
  ASSERT_TRUE(above.has_value());
  EXPECT_EQ(above->index, 0) << "over the first disc's edge the second one is met";
  EXPECT_FALSE(caster->Cast(RayTo({0.0, 0.0, 1.0}, {0.0, 0.0, 5.0}), 50.0).has_value());
}

TEST(RayCaster, RespectsTheLargestRange) {
  SceneMap map;
  map.surfels = {Disc({6.0F, 0.0F, 1.0F}, {1.0F, 0.0F, 0.0F}, 0.8F)};
  const auto caster = RayCaster::Create(map);
  ASSERT_TRUE(caster.ok());
  const Ray ray = RayTo({0.0, 0.0, 1.0}, {6.0, 0.0, 1.0});
  EXPECT_FALSE(caster->Cast(ray, 5.9).has_value());
  EXPECT_TRUE(caster->Cast(ray, 6.1).has_value()) << "both sides of a surfel stop a ray";
}

TEST(RayCaster, AnswersManyRaysInOrderWithAnyNumberOfThreads) {
  SceneMap map;
  map.ground = Road(0.05, 0.003);
  Random random(3);
  for (int i = 0; i < 500; ++i) {
    map.surfels.push_back(
        Disc(Eigen::Vector3d(random.Uniform(-9, 9), random.Uniform(-9, 9), random.Uniform(0.5, 4))
                 .cast<float>(),
             Eigen::Vector3d(random.Gaussian(), random.Gaussian(), random.Gaussian()).cast<float>(),
             0.3F));
  }
  const auto caster = RayCaster::Create(map);
  ASSERT_TRUE(caster.ok());
  std::vector<Ray> rays;
  for (int i = 0; i < 5000; ++i) {
    rays.push_back(RayTo({0.0, 0.0, 2.0},
                         {random.Uniform(-9, 9), random.Uniform(-9, 9), random.Uniform(-1, 4)}));
  }
  const auto hits = caster->Cast(rays, 100.0);
  tbb::global_control one_thread(tbb::global_control::max_allowed_parallelism, 1);
  const auto hits_of_one_thread = caster->Cast(rays, 100.0);
  int num_hits = 0;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const auto single = caster->Cast(rays[i], 100.0);
    ASSERT_EQ(hits[i].has_value(), single.has_value());
    ASSERT_EQ(hits_of_one_thread[i].has_value(), single.has_value());
    if (!single) continue;
    ++num_hits;
    EXPECT_EQ(hits[i]->point_in_map_m, single->point_in_map_m);
    EXPECT_EQ(hits_of_one_thread[i]->index, single->index);
  }
  EXPECT_GT(num_hits, 2500);
}

}  // namespace
}  // namespace scenecalib
