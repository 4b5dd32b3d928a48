#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace scenecalib {

/// The value below which about a share (0 to 1) of them lies; NaN of none.
inline double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return std::nan("");
  const auto rank = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + rank, values.end());
  return values[static_cast<std::size_t>(rank)];
}

}  // namespace scenecalib
