#pragma once

namespace scenecalib {

/// What the data says of a lens' radial coefficient (RadialCoefficient), which no solve moves by
/// itself: where the true lens probably is, from the one in use.
struct RadialMisfit {
  double change = 0.0;
  double stddev = 0.0;
  /// Displacement that the change is worth where it moves the image most, px.
  double edge_px = 0.0;
};

}  // namespace scenecalib
