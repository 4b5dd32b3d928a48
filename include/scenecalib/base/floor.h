#pragma once

#include <cstdint>

namespace scenecalib {

/// The largest integer that is not above a number of magnitude below 2^62; NaN has no result. Where
/// it is called millions of times: std::floor is a library call on processors that might lack the
/// instruction.
template <typename Number>
std::int64_t Floor(Number x) {
  const auto truncated = static_cast<std::int64_t>(x);
  return truncated - (static_cast<Number>(truncated) > x ? 1 : 0);
}

}  // namespace scenecalib
