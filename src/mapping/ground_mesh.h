#pragma once

#include <vector>

#include "lidar_return.h"
#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

/// Screened Poisson surface of the returns marked as ground (height_field.h), with holes where
/// there is no data: tile by tile in parallel, each on one thread. Counter-clockwise seen from
/// above. Empty when there is too little ground.
///
/// Differs from the paper: the surface is a height field and not the zero of an indicator function
/// in space. The ground has one height at every place but for the faces of kerbs, which become one
/// cell wide; in exchange a tile takes tens of milliseconds instead of hundreds, tiles run side by
/// side (pcl::Poisson keeps global state), no surface closes itself around the data's border, and
/// the mesh is watertight.
TriangleMesh BuildGroundMesh(const std::vector<LidarReturn>& points,
                             const std::vector<PointLabel>& labels, const GroundOptions& options);

}  // namespace scenecalib
