#pragma once

#include <Eigen/Core>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/base/progress.h"
#include "scenecalib/base/status.h"
#include "scenecalib/base/timestamp.h"
#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

/// A lidar return placed in the map by the trajectory at its own time.
struct RegisteredPoint {
  Eigen::Vector3f position_in_map_m = Eigen::Vector3f::Zero();
  float time_offset_s = 0.0F;  ///< point time minus RegisteredScan::stamp_ns
  float intensity = 0.0F;
};

/// A deskewed scan in the map frame (z up).
struct RegisteredScan {
  Timestamp stamp_ns = 0;
  Eigen::Vector3d lidar_in_map_m = Eigen::Vector3d::Zero();  ///< sensor position at mid-scan
  std::vector<RegisteredPoint> points;
};

/// How the surfaces are built from registered scans.
struct SurfaceOptions {
  double map_voxel_size_m = 0.1;
  void Visit(OptionVisitor& v) {
    v.Field("map_voxel_size_m", &map_voxel_size_m, {0.02, 2.0},
            "edge of a voxel of the kept cloud");
  }
};

/// Surfaces without moving objects, with the evidence.
struct Surfaces {
  TriangleMesh ground;
  std::vector<Surfel> surfels;
  std::vector<MapPoint> points;
  int num_points_in = 0;
  int num_points_moving = 0;
  int num_points_ground = 0;
  double median_surfel_thickness_m = 0.0;  ///< over planar surfels
};

/// Removes moving objects, makes the ground a Poisson mesh and everything above it surfels (III-A).
/// Deterministic, whatever the number of threads. InsufficientData when nothing is left.
Result<Surfaces> BuildSurfaces(const std::vector<RegisteredScan>& scans,
                               const SurfaceOptions& options, const ProgressCallback& progress);

}  // namespace scenecalib
