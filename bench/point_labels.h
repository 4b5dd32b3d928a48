#pragma once

#include <vector>

#include "scenecalib/mapping/surface_builder.h"

namespace scenecalib {

/// What became of a return on its way into the surfaces.
enum class ReturnFate { kStructure, kGround, kMoving };

/// One per point of each scan. No point may lie nearer than options.min_range_m.
std::vector<std::vector<ReturnFate>> LabelReturns(const std::vector<RegisteredScan>& scans,
                                                  const SurfaceOptions& options);

}  // namespace scenecalib
