#pragma once

#include "scenecalib/base/options.h"

namespace scenecalib {

/// The continuous-time representation of the trajectory.
struct RefinementOptions {
  double knot_interval_s = 0.05;
  void Visit(OptionVisitor& v) {
    v.Field("knot_interval_s", &knot_interval_s, {0.01, 0.5}, "between knots of the pose spline");
  }
};

}  // namespace scenecalib
