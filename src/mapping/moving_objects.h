#pragma once

#include <vector>

#include "lidar_return.h"

namespace scenecalib {

/// Marks the returns from moving objects among the structure (`labels` says what is ground) and
/// returns how many.
///
/// A place (small voxel) is judged by scans spread over the segment: each saw it occupied, saw
/// through it, or cannot tell. A place that is free for a stretch of the segment and occupied for
/// another is moving; foliage, fences and poles, through which some rays always pass, alternate
/// instead and stay, as do parked cars. Every object of one scan that consists of such places to a
/// good part goes as a whole, with its parts that nothing was ever seen behind.
int RemoveMovingObjects(const std::vector<LidarReturn>& points, const MovingObjectOptions& options,
                        std::vector<PointLabel>* labels);

}  // namespace scenecalib
