#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/geometry/trajectory.h"

namespace scenecalib {

/// An oriented disc fitted to lidar points (structure above the ground), in the map frame.
struct Surfel {
  Eigen::Vector3f center_m = Eigen::Vector3f::Zero();
  Eigen::Vector3f normal = Eigen::Vector3f::UnitZ();  ///< unit, towards the sensor that saw it
  float radius_m = 0.0F;
  float thickness_m = 0.0F;  ///< RMS distance of its points to its plane
  float scale_m = 0.0F;      ///< edge of the voxel it was fitted in, about 0.1 to 1.6 m
  int num_points = 0;
  Timestamp first_seen_ns = 0;
  Timestamp last_seen_ns = 0;
  /// False for foliage, edges and clutter: such a surfel occludes but ties no track to a plane.
  bool planar = true;
};

/// Triangles of the ground, in the map frame; counter-clockwise seen from above.
struct TriangleMesh {
  std::vector<Eigen::Vector3f> vertices_m;
  std::vector<std::array<int, 3>> triangles;
};

/// A static point of the accumulated cloud, for overlays, colouring and photometric evaluation.
struct MapPoint {
  Eigen::Vector3f position_m = Eigen::Vector3f::Zero();
  float intensity = 0.0F;
};

/// RMS of the trajectory's relative error (between two times that far apart) as the mapping itself
/// estimates it.
struct RelativeMotionSigma {
  double window_s = 0.0;
  double translation_m = 0.0;
  double rotation_rad = 0.0;
};

/// What the lidar's own frame is uncertain by, per axis: its lasers' errors have a mean, which
/// nothing shows but how much they differ.
struct LidarFrameSigma {
  double translation_m = 0.0;
  double rotation_rad = 0.0;
};

/// What the lidar says about the scene (III-A): its own trajectory and locally planar surfaces, all
/// from the same trajectory. The map frame is the lidar frame at the trajectory's first pose,
/// turned so that z points up when gravity or the ground says where that is.
struct SceneMap {
  Trajectory map_from_lidar;
  TriangleMesh ground;
  std::vector<Surfel> surfels;
  std::vector<MapPoint> points;  ///< down-sampled, without moving objects
  std::vector<RelativeMotionSigma> relative_motion;
  LidarFrameSigma lidar_frame;
};

}  // namespace scenecalib
