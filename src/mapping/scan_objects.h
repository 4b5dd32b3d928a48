#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "lidar_return.h"

namespace scenecalib {

/// What the judging scans found of a place, kept per point.
enum class PlaceKind : std::uint8_t { kUnknown, kStatic, kMoving };

/// Things of one scan that stand apart from each other: connected returns above the ground.
struct ScanObject {
  std::vector<int> points;  ///< indices, ascending
  int num_moving = 0;       ///< of them in moving places
  Eigen::AlignedBox3f box;
  Eigen::Vector3f centroid_m = Eigen::Vector3f::Zero();
  bool moving = false;
};

/// The objects among points[begin, end), one scan, no larger than options.max_object_extent_m.
/// What is known to be static separates: a car that passes a parked one is still an object of its
/// own. An object moves when enough of it lies in moving places.
std::vector<ScanObject> FindScanObjects(const std::vector<LidarReturn>& points,
                                        const std::vector<PointLabel>& labels,
                                        const std::vector<PlaceKind>& kinds, int begin, int end,
                                        const MovingObjectOptions& options);

/// Follows moving objects from scan to scan, forwards and backwards, and marks as moving what is
/// met where they should be: the car ahead at the end of a drive, behind which nothing was ever
/// seen, is the one that drove there before. One list of objects per scan.
void FollowMovingObjects(std::vector<std::vector<ScanObject>>* objects_of_scan);

}  // namespace scenecalib
