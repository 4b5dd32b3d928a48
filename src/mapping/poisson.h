#pragma once

#include <vector>

#include "ground_samples.h"
#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

/// Screened Poisson surface of the samples with octree leaves of at most cell_m. It is closed far
/// beyond the data: cut it. Deterministic. One call at a time runs, others wait: pcl::Poisson keeps
/// its octree and its matrices in arenas that all calls in a process share.
TriangleMesh PoissonSurface(const std::vector<GroundSample>& samples, double cell_m,
                            double point_weight);

}  // namespace scenecalib
