#pragma once

#include "scenecalib/base/options.h"

namespace scenecalib {

/// Everything that steers association and calibration.
struct CalibrationOptions {
  bool hold_intrinsics = false;
  bool estimate_time_offset = false;
  int seed = 1;
  void Visit(OptionVisitor& v) {
    v.Field("hold_intrinsics", &hold_intrinsics, "keep s_f and u_0 at their initial values");
    v.Field("estimate_time_offset", &estimate_time_offset,
            "refine each camera's time offset to the lidar clock");
    v.Field("seed", &seed, {0, 2147483647}, "seed of every random choice");
  }
};

}  // namespace scenecalib
