#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/simulation/mesh.h"

namespace scenecalib {

/// What a ray meets first.
struct SceneHit {
  static constexpr std::int32_t kNone = -1;   ///< the sky
  static constexpr std::int32_t kStatic = 0;  ///< the world; i + 1 is the i-th moving object
  std::int32_t object = kNone;
  std::uint32_t triangle = 0;
  float range_m = 0.0F;
  float u = 0.0F, v = 0.0F;                                 ///< barycentric: (1 - u - v, u, v)
  Eigen::Vector3f normal_in_map = Eigen::Vector3f::Zero();  ///< unit, against the ray
};

/// How a batch of rays is traced.
struct TraceOptions {
  bool coherent = false;  ///< the rays point about the same way
  int num_objects = 0;    ///< only the first moving objects are seen
  float max_range_m = 1e4F;
};

/// Casts rays into a static mesh and rigid moving objects (Embree). Moving objects keep their own
/// scenes and rays are carried into their frames, so any number of instants can be traced at once.
/// Const calls are thread-safe and the same for any number of threads.
class SceneTracer {
 public:
  /// Takes the meshes over. `shadow_mesh` casts shadows where leaves do not.
  static Result<SceneTracer> Create(Mesh world, const Mesh& shadow_mesh, std::vector<Mesh> objects);
  ~SceneTracer();
  SceneTracer(SceneTracer&&) noexcept;
  SceneTracer& operator=(SceneTracer&&) noexcept;

  int num_objects() const;
  std::size_t num_triangles() const;

  /// Traces unit directions from one origin. `map_from_object` holds the moving objects' poses.
  void Trace(const Eigen::Vector3d& origin_in_map_m, const Eigen::Vector3f* directions_in_map,
             std::size_t num_rays, const std::vector<Rigid3>& map_from_object,
             const TraceOptions& options, SceneHit* hits) const;

  /// Sets lit[i] to whether the sun reaches the point.
  void TraceSun(const Eigen::Vector3f* points_in_map_m, std::size_t num_points,
                const Eigen::Vector3f& towards_sun, const std::vector<Rigid3>& map_from_object,
                bool* lit) const;

  const Surface& SurfaceOf(const SceneHit& hit) const;
  /// Reflectance (blue, green, red) at the hit, averaged over a pixel whose ray changes by
  /// ray_dx and ray_dy (map frame) towards its neighbours.
  Eigen::Vector3f Albedo(const SceneHit& hit, const Eigen::Vector3f& direction_in_map,
                         const Eigen::Vector3f& ray_dx, const Eigen::Vector3f& ray_dy,
                         const std::vector<Rigid3>& map_from_object) const;

 private:
  struct Impl;
  explicit SceneTracer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace scenecalib
