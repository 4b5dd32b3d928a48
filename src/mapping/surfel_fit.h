#pragma once

#include <vector>

#include "lidar_return.h"
#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

/// Covers the structure above the ground with surfels.
///
/// From voxels of the coarsest size down, every plane that many points of a voxel agree with is
/// peeled off; what is left goes to the voxel's eight parts. So each place is covered by the
/// largest planar patch that holds there, and a pole before a wall does not spoil the wall. A patch
/// is the set of small cells of its plane whose points have no systematic offset from it, and
/// becomes several discs that share the patch's plane, scale and thickness but keep to the places
/// where there are points, and a rim of occluders around its border. What is not planar at the
/// finest size becomes occluders (planar = false).
///
/// Foliage holds some points that look like a plane wherever one looks. It is recognised by planes
/// thicker than range noise makes them at the angle that they are seen at, and by the points around
/// that lie on no plane.
///
/// stamps_ns is by scan. Deterministic: voxels are independent and joined in the order of their
/// keys.
std::vector<Surfel> FitSurfels(const std::vector<LidarReturn>& points,
                               const std::vector<PointLabel>& labels,
                               const std::vector<Timestamp>& stamps_ns,
                               const SurfelOptions& options);

/// Standard deviations of the returns about planar structure, metres: range noise and whatever the
/// trajectory adds.
struct SurfaceNoise {
  double across_m = 0.0;     ///< distance to the plane, at the angles that surfaces are seen at
  double along_ray_m = 0.0;  ///< the same for surfaces seen head-on
};

/// Estimated from small planar voxels.
SurfaceNoise EstimateSurfaceNoise(const std::vector<LidarReturn>& points, const VoxelGroups& voxels,
                                  const SurfelOptions& options);

}  // namespace scenecalib
