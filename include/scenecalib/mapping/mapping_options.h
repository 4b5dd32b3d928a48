#pragma once

#include "scenecalib/base/options.h"
#include "scenecalib/mapping/lidar_odometry.h"
#include "scenecalib/mapping/surface_builder.h"
#include "scenecalib/mapping/trajectory_refiner.h"

namespace scenecalib {

/// How much of the past a mapper keeps. A scan of 64 x 1024 points takes 1.4 MB.
struct ScanBufferOptions {
  int max_scans = 600;
  double max_imu_age_s = 300.0;
  void Visit(OptionVisitor& v) {
    v.Field("max_scans", &max_scans, {10, 100000},
            "scans kept; beyond it the oldest are forgotten");
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
