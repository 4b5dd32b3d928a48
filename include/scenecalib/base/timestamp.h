#pragma once

#include <cmath>
#include <cstdint>

namespace scenecalib {

/// Nanoseconds since the Unix epoch (ROS time), on the clock that the variable's name says.
using Timestamp = std::int64_t;

/// later - earlier, in seconds.
inline double SecondsBetween(Timestamp earlier, Timestamp later) {
  return static_cast<double>(later - earlier) * 1e-9;
}

/// stamp + seconds, rounded to the nearest nanosecond.
inline Timestamp AddSeconds(Timestamp stamp, double seconds) {
  return stamp + static_cast<Timestamp>(std::llround(seconds * 1e9));
}

}  // namespace scenecalib
