#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

struct Ray {
  Eigen::Vector3d origin_in_map_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d direction_in_map = Eigen::Vector3d::UnitX();  ///< unit
};

enum class SurfaceKind { kGround, kSurfel };

/// Where a ray first meets the map.
struct RayHit {
  double range_m = 0.0;
  Eigen::Vector3d point_in_map_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal_in_map = Eigen::Vector3d::UnitZ();  ///< unit, against the ray
  SurfaceKind kind = SurfaceKind::kGround;
  int index = 0;                     ///< into SceneMap::ground.triangles or SceneMap::surfels
  double scale_m = 0.0;              ///< size of the planar neighbourhood it stands for
  double thickness_m = 0.0;          ///< RMS distance of the lidar points to the surface
  bool planar = true;                ///< false: an occluder only (foliage, edge)
  double incidence_angle_rad = 0.0;  ///< between the reversed ray and the normal, [0, pi/2]
};

/// Ray casting against the ground mesh and the surfels (discs) in Embree.
/// Copies what it needs from the map; safe to use from many threads.
class RayCaster {
 public:
  /// InsufficientData when the map has no surface at all.
  static Result<RayCaster> Create(const SceneMap& map);
  RayCaster(RayCaster&&) noexcept;
  RayCaster& operator=(RayCaster&&) noexcept;
  ~RayCaster();

  /// First surface within max_range_m; none when the ray leaves the map.
  std::optional<RayHit> Cast(const Ray& ray, double max_range_m) const;

  /// The same for many rays in parallel, in the order given.
  std::vector<std::optional<RayHit>> Cast(const std::vector<Ray>& rays, double max_range_m) const;

 private:
  struct Impl;
  explicit RayCaster(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace scenecalib
