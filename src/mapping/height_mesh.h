#pragma once

#include "height_field.h"
#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

/// Appends triangles over the square of 2^k x 2^k cells whose lowest vertex is (first, first) of
/// the field, as few as keep within max_error_m of its heights: right-triangulated irregular
/// network (Evans, Kirkpatrick and Townsend 2001). Watertight within the square; along its sides
/// every vertex is used, so that squares side by side join. No edge is longer than max_leg_cells
/// along an axis. Where a height is missing there is no triangle. Counter-clockwise seen from
/// above.
void AppendHeightMesh(const HeightField& field, int first, int num_cells, int max_leg_cells,
                      float max_error_m, TriangleMesh* mesh);

}  // namespace scenecalib
