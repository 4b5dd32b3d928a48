#pragma once

#include <vector>

#include "scene_point.h"
#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

/// Poisson surface of the returns marked as ground (Kazhdan, Bolitho and Hoppe 2006, screened, by
/// pcl::Poisson), cut where there is no data. Counter-clockwise seen from above. Empty when there
/// is too little ground.
TriangleMesh BuildGroundMesh(const std::vector<ScenePoint>& points,
                             const std::vector<PointLabel>& labels, const GroundOptions& options);

}  // namespace scenecalib
