#pragma once

#include <vector>

#include "ground_samples.h"
#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

/// Moves a ground surface's vertices up or down by what the flat samples around them are off it in
/// the mean. Poisson's surface waves by 3 to 4 mm about data that is good to less than one: its
/// iso value is one for the whole tile, and its octree is coarser than the data.
void CorrectHeights(const std::vector<GroundSample>& samples, TriangleMesh* surface);

}  // namespace scenecalib
