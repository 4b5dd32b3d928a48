#pragma once

#include <vector>

#include "lidar_return.h"

namespace scenecalib {

/// Marks the returns from the ground (road, kerbs, pavement) in `labels`, one per point.
///
/// Every cell of a grid gets the height of its lowest dense returns; the ground grows from the
/// cells below the sensor's path to neighbours whose height differs by less than a kerb, climbing
/// more than a slope's worth only onto cells that are flat (a pavement is, a car's side is not).
/// Returns the number of points marked.
int SegmentGround(const std::vector<LidarReturn>& points, const GroundOptions& options,
                  std::vector<PointLabel>* labels);

}  // namespace scenecalib
