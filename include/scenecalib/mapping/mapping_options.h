#pragma once

#include "scenecalib/base/options.h"
#include "scenecalib/mapping/surface_builder.h"

namespace scenecalib {

/// How much of the past a mapper keeps.
struct ScanBufferOptions {
  int max_scans = 1500;
  void Visit(OptionVisitor& v) {
    v.Field("max_scans", &max_scans, {10, 100000},
            "scans kept; beyond it the oldest are forgotten");
  }
};

/// Everything that steers lidar mapping.
struct MappingOptions {
  ScanBufferOptions buffer;
  SurfaceOptions surfaces;
  void Visit(OptionVisitor& v) {
    v.Group("buffer", &buffer);
    v.Group("surfaces", &surfaces);
  }
};

}  // namespace scenecalib
