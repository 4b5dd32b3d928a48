#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "scenecalib/base/floor.h"
#include "scenecalib/mapping/surface_builder.h"

namespace scenecalib {

/// A lidar return with the place it was measured from.
struct LidarReturn {
  Eigen::Vector3f position_m = Eigen::Vector3f::Zero();  ///< in the map
  Eigen::Vector3f origin_m = Eigen::Vector3f::Zero();    ///< the sensor at the point's own time
  float intensity = 0.0F;
  int scan = 0;  ///< index of its scan; a scan's points are contiguous
};

/// All returns beyond min_range_m, scan by scan. The sensor moves by a metre during a sweep: its
/// position at each point's time is interpolated between the scans' mid-scan positions.
std::vector<LidarReturn> CollectReturns(const std::vector<RegisteredScan>& scans,
                                        double min_range_m);

/// What a return was found to be.
enum class PointLabel : std::uint8_t { kStructure, kGround, kMoving };

/// A voxel index packed into 21 bits per axis (a million voxels to each side of the origin), in an
/// order that does not depend on how the points came.
inline std::uint64_t VoxelKey(const Eigen::Vector3f& position_m, float inverse_edge) {
  constexpr std::int64_t kHalf = 1 << 20;
  constexpr std::uint64_t kMask = (1 << 21) - 1;
  std::uint64_t key = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const std::int64_t index = Floor(position_m[axis] * inverse_edge);
    key = (key << 21) | (static_cast<std::uint64_t>(index + kHalf) & kMask);
  }
  return key;
}

/// The key of the voxel that lies (dx, dy, dz) voxels away.
inline std::uint64_t NeighborVoxelKey(std::uint64_t key, int dx, int dy, int dz) {
  return key + (static_cast<std::uint64_t>(static_cast<std::int64_t>(dx)) << 42) +
         (static_cast<std::uint64_t>(static_cast<std::int64_t>(dy)) << 21) +
         static_cast<std::uint64_t>(static_cast<std::int64_t>(dz));
}

/// Points grouped by voxel: voxel v holds order[begin[v]] ... order[begin[v + 1] - 1].
struct VoxelGroups {
  std::vector<std::uint64_t> keys;  ///< ascending
  std::vector<int> begin;           ///< one more than keys
  std::vector<int> order;           ///< point indices; within a voxel as they were listed

  int size() const { return static_cast<int>(keys.size()); }
  /// Index of the voxel with that key, or -1.
  int Find(std::uint64_t key) const;
};

/// Groups the points listed in `indices`.
VoxelGroups GroupByVoxel(const std::vector<LidarReturn>& points, const std::vector<int>& indices,
                         double voxel_size_m);

}  // namespace scenecalib
