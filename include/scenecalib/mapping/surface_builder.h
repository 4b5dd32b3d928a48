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

/// Removal of moving objects: a place is moving when rays saw through it before or after it was
/// occupied (visibility in range images), and the object that holds such places goes as a whole.
struct MovingObjectOptions {
  bool enabled = true;
  double voxel_size_m = 0.2;
  double max_test_range_m = 40.0;
  double free_margin_m = 0.4;
  double test_spacing_m = 2.5;
  int test_spacing_scans = 3;
  int min_free_scans = 3;
  double min_moving_share = 0.3;
  double max_object_extent_m = 15.0;
  void Visit(OptionVisitor& v) {
    v.Field("enabled", &enabled, "remove moving objects");
    v.Field("voxel_size_m", &voxel_size_m, {0.05, 1.0}, "edge of a place that is judged");
    v.Field("max_test_range_m", &max_test_range_m, {5.0, 200.0},
            "a place is judged by scans taken from nearer than this");
    v.Field("free_margin_m", &free_margin_m, {0.05, 2.0},
            "a ray has to end this far behind a place to prove it free");
    v.Field("test_spacing_m", &test_spacing_m, {0.1, 100.0},
            "a scan taken so far from the last that judged places judges too");
    v.Field("test_spacing_scans", &test_spacing_scans, {1, 1000},
            "and one that came so many scans after it");
    v.Field("min_free_scans", &min_free_scans, {1, 100}, "scans that have to see through a place");
    v.Field("min_moving_share", &min_moving_share, {0.0, 1.0},
            "share of moving points from which a whole object of one scan counts as moving");
    v.Field("max_object_extent_m", &max_object_extent_m, {1.0, 50.0},
            "a larger cluster is structure, not an object");
  }
};

/// Ground segmentation and the ground's Poisson mesh.
struct GroundOptions {
  double cell_size_m = 0.25;
  double max_step_m = 0.2;
  double max_height_above_low_m = 0.07;
  double max_range_m = 50.0;
  double column_size_m = 0.1;
  double tile_size_m = 12.8;
  double tile_overlap_m = 0.8;
  double mesh_cell_m = 0.05;
  double smoothing_m = 0.3;
  double max_hole_m = 0.4;
  void Visit(OptionVisitor& v) {
    v.Field("cell_size_m", &cell_size_m, {0.05, 2.0}, "edge of a segmentation cell");
    v.Field("max_step_m", &max_step_m, {0.05, 0.5}, "highest kerb that the ground may climb");
    v.Field("max_height_above_low_m", &max_height_above_low_m, {0.02, 0.5},
            "a point is ground up to this height over the lowest ground around");
    v.Field("max_range_m", &max_range_m, {10.0, 200.0}, "ground returns used, from the sensor");
    v.Field("column_size_m", &column_size_m, {0.02, 0.5},
            "ground points are averaged in columns of this edge");
    v.Field("tile_size_m", &tile_size_m, {4.0, 100.0},
            "edge of a tile; tiles are solved in parallel");
    v.Field("tile_overlap_m", &tile_overlap_m, {0.3, 10.0}, "data around a tile that it also sees");
    v.Field("mesh_cell_m", &mesh_cell_m, {0.03, 1.0},
            "largest distance of the lattice's heights; flat ground takes larger triangles");
    v.Field("smoothing_m", &smoothing_m, {0.01, 5.0},
            "noise of the ground's heights is averaged over about this length");
    v.Field("max_hole_m", &max_hole_m, {0.1, 5.0}, "the mesh is cut where data is farther off");
  }
};

/// Multi-scale surfels above the ground.
struct SurfelOptions {
  double coarsest_voxel_m = 1.6;
  int num_levels = 5;
  double max_range_m = 80.0;
  double min_noise_m = 0.003;
  double max_noise_m = 0.06;
  double max_bias_m = 0.01;
  int min_points_planar = 10;
  int min_points_occluder = 4;
  void Visit(OptionVisitor& v) {
    v.Field("coarsest_voxel_m", &coarsest_voxel_m, {0.2, 10.0}, "edge of the first voxels tried");
    v.Field("num_levels", &num_levels, {1, 8}, "each level halves the voxel: 5 from 1.6 to 0.1 m");
    v.Field("max_range_m", &max_range_m, {10.0, 300.0}, "returns used, from the sensor");
    v.Field("min_noise_m", &min_noise_m, {0.0005, 0.1}, "lower bound of the estimated noise");
    v.Field("max_noise_m", &max_noise_m, {0.001, 0.3}, "upper bound of the estimated noise");
    v.Field("max_bias_m", &max_bias_m, {0.001, 0.1},
            "mean offset of a patch's cell from its plane that still counts as flat");
    v.Field("min_points_planar", &min_points_planar, {4, 1000}, "points of a planar surfel's fit");
    v.Field("min_points_occluder", &min_points_occluder, {1, 1000},
            "points that make a voxel of clutter an occluder");
  }
};

/// How the surfaces are built from registered scans.
struct SurfaceOptions {
  double min_range_m = 3.0;
  double map_voxel_size_m = 0.1;
  MovingObjectOptions moving_objects;
  GroundOptions ground;
  SurfelOptions surfels;
  void Visit(OptionVisitor& v) {
    v.Field("min_range_m", &min_range_m, {0.0, 20.0},
            "nearer returns are the vehicle itself and are left out");
    v.Field("map_voxel_size_m", &map_voxel_size_m, {0.02, 2.0},
            "edge of a voxel of the kept cloud");
    v.Group("moving_objects", &moving_objects);
    v.Group("ground", &ground);
    v.Group("surfels", &surfels);
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
