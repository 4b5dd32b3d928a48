#pragma once

#include "scenecalib/base/options.h"
#include "scenecalib/mapping/lidar_odometry.h"
#include "scenecalib/mapping/surface_builder.h"
#include "scenecalib/mapping/trajectory_refiner.h"

namespace scenecalib {

/// How much of the past a mapper keeps, at 12 bytes a point, and how much of it becomes surfaces,
/// at about 90 bytes a point while they are built.
struct ScanBufferOptions {
  int max_scans = 1500;
  int max_points = 54000000;
  int max_surface_points = 14000000;
  double max_imu_age_s = 300.0;
  void Visit(OptionVisitor& v) {
    v.Field("max_scans", &max_scans, {10, 100000},
            "scans kept; beyond it the oldest are forgotten");
    v.Field("max_points", &max_points, {100000, 2000000000},
            "points of all scans kept; beyond it the oldest scans are forgotten");
    v.Field("max_surface_points", &max_surface_points, {100000, 1000000000},
            "points the surfaces are built from; beyond it scans are left out, evenly along the "
            "drive");
    v.Field("max_imu_age_s", &max_imu_age_s, {1.0, 1e5},
            "IMU and odometry samples older than this, before the newest, are forgotten");
  }
};

/// What a segment must have to be worth mapping.
struct SegmentOptions {
  double min_path_length_m = 2.0;
  int min_scans = 5;
  void Visit(OptionVisitor& v) {
    v.Field("min_path_length_m", &min_path_length_m, {0.1, 1000.0},
            "a shorter drive is refused: without motion no camera can be calibrated");
    v.Field("min_scans", &min_scans, {2, 1000}, "fewer registered scans are refused");
  }
};

/// Everything that steers lidar mapping.
struct MappingOptions {
  ScanBufferOptions buffer;
  SegmentOptions segment;
  OdometryOptions odometry;
  RefinementOptions refinement;
  SurfaceOptions surfaces;
  void Visit(OptionVisitor& v) {
    v.Group("buffer", &buffer);
    v.Group("segment", &segment);
    v.Group("odometry", &odometry);
    v.Group("refinement", &refinement);
    v.Group("surfaces", &surfaces);
  }
};

}  // namespace scenecalib
