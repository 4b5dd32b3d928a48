#pragma once

namespace scenecalib {

/// What the data says of when a camera's rows are exposed, from the times in use: the time between
/// rows (the rig file's, or 0: a global shutter), which no solve moves by itself, and the time
/// offset, where it is not solved for.
struct ClockMisfit {
  double line_time_change_s = 0.0;
  double line_time_stddev_s = 0.0;
  double time_offset_change_s = 0.0;
  double time_offset_stddev_s = 0.0;
};

}  // namespace scenecalib
