// Rays per second against a street's ground mesh and 500 000 surfels. "Incoherent": every ray from
// its own place along the street, in a direction of its own.

#include <benchmark/benchmark.h>

#include <Eigen/Geometry>
#include <cmath>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/mapping/ray_caster.h"

namespace scenecalib {
namespace {

constexpr double kLength_m = 400.0;
constexpr int kNumSurfels = 500000;

TriangleMesh StreetGround(Random random) {
  constexpr double kCell_m = 0.16;
  const int rows = static_cast<int>(kLength_m / kCell_m);
  const int columns = static_cast<int>(14.0 / kCell_m);
  TriangleMesh mesh;
  for (int i = 0; i <= rows; ++i) {
    for (int j = 0; j <= columns; ++j) {
      mesh.vertices_m.push_back(Eigen::Vector3d(kCell_m * i - 0.5 * kLength_m, kCell_m * j - 7.0,
                                                0.002 * random.Gaussian())
                                    .cast<float>());
    }
  }
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < columns; ++j) {
      const int k = i * (columns + 1) + j;
      mesh.triangles.push_back({k, k + columns + 1, k + 1});
      mesh.triangles.push_back({k + 1, k + columns + 1, k + columns + 2});
    }
  }
  return mesh;
}

/// Facades on both sides and clusters of small discs of any orientation (trees, clutter) before
/// them.
std::vector<Surfel> StreetSurfels(Random random) {
  std::vector<Surfel> surfels;
  Surfel surfel;
  constexpr double kCell_m = 0.2;
  for (const double side : {-1.0, 1.0}) {
    for (double x = -0.5 * kLength_m; x < 0.5 * kLength_m; x += kCell_m) {
      const double y = side * (8.0 + 0.5 * (static_cast<int>(x / 10.0) % 3));
      for (double z = 0.0; z < 12.0; z += kCell_m) {
        surfel.center_m = Eigen::Vector3d(x, y, z).cast<float>();
        surfel.normal =
            Eigen::Vector3d(random.Uniform(-0.02, 0.02), -side, random.Uniform(-0.02, 0.02))
                .normalized()
                .cast<float>();
        surfel.radius_m = 0.72F * static_cast<float>(kCell_m);
        surfels.push_back(surfel);
      }
    }
  }
  surfel.planar = false;
  while (surfels.size() < kNumSurfels) {
    const double side = random.Uniform() < 0.5 ? -1.0 : 1.0;
    const Eigen::Vector3d cluster_m(random.Uniform(-0.5 * kLength_m, 0.5 * kLength_m),
                                    side * random.Uniform(3.0, 7.0), random.Uniform(0.0, 5.0));
    for (int k = 0; k < 40; ++k) {
      const Eigen::Vector3d offset_m(random.Uniform(-1.0, 1.0), random.Uniform(-1.0, 1.0),
                                     random.Uniform(-1.0, 1.0));
      surfel.center_m = (cluster_m + offset_m).cast<float>();
      surfel.normal = Eigen::Vector3d(random.Gaussian(), random.Gaussian(), random.Gaussian())
                          .normalized()
                          .cast<float>();
      surfel.radius_m = static_cast<float>(random.Uniform(0.04, 0.1));
      surfels.push_back(surfel);
    }
  }
  surfels.resize(kNumSurfels);
  return surfels;
}

const RayCaster& Street() {
  static const RayCaster* const caster = [] {
    SceneMap map;
    map.ground = StreetGround(Random(1));
    map.surfels = StreetSurfels(Random(2));
    return new RayCaster(RayCaster::Create(map).value());
  }();
  return *caster;
}

std::vector<Ray> IncoherentRays(int count) {
  Random random(3);
  std::vector<Ray> rays(count);
  for (Ray& ray : rays) {
    ray.origin_in_map_m = {random.Uniform(-190.0, 190.0), random.Uniform(-2.0, 2.0),
                           random.Uniform(1.2, 2.0)};
    const double azimuth = random.Uniform(-M_PI, M_PI);
    const double elevation = random.Uniform(-0.5, 0.4);
    ray.direction_in_map = {std::cos(azimuth) * std::cos(elevation),
                            std::sin(azimuth) * std::cos(elevation), std::sin(elevation)};
  }
  return rays;
}

void CastIncoherentRays(benchmark::State& state) {
  const std::vector<Ray> rays = IncoherentRays(static_cast<int>(state.range(0)));
  const RayCaster& caster = Street();
  for (auto _ : state) benchmark::DoNotOptimize(caster.Cast(rays, 80.0));
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(rays.size()));
}
BENCHMARK(CastIncoherentRays)->Arg(20000)->Arg(500000)->UseRealTime()->MeasureProcessCPUTime();

/// Ray by ray, as association casts the bundle of a track: here without any coherence, one thread.
void CastOneByOne(benchmark::State& state) {
  const std::vector<Ray> rays = IncoherentRays(50000);
  const RayCaster& caster = Street();
  for (auto _ : state) {
    for (const Ray& ray : rays) benchmark::DoNotOptimize(caster.Cast(ray, 80.0));
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(rays.size()));
}
BENCHMARK(CastOneByOne);

}  // namespace
}  // namespace scenecalib
