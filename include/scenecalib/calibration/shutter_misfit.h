#pragma once

namespace scenecalib {

/// What the data says of the time between a camera's rows, which no solve moves by itself: where
/// the truth probably is, from the value in use (the rig file's, or 0: a global shutter).
struct ShutterMisfit {
  double line_time_change_s = 0.0;
  double stddev_s = 0.0;
};

}  // namespace scenecalib
