#pragma once

#include <Eigen/Core>
#include <limits>
#include <vector>

#include "ground_samples.h"

namespace scenecalib {

/// Heights of a square lattice in the map; NaN where nothing was seen.
struct HeightField {
  Eigen::Vector2f origin_m = Eigen::Vector2f::Zero();  ///< of vertex (0, 0)
  float cell_m = 0.0F;
  int width = 0;  ///< vertices along x
  int height = 0;
  std::vector<float> z_m;  ///< row by row: y * width + x

  int IndexOf(int x, int y) const { return y * width + x; }
  float At(int x, int y) const { return z_m[y * width + x]; }
  Eigen::Vector3f Vertex(int x, int y) const {
    return {origin_m.x() + cell_m * static_cast<float>(x),
            origin_m.y() + cell_m * static_cast<float>(y), At(x, y)};
  }
};

/// What steers the heights between the samples.
struct HeightFieldOptions {
  double smoothing_m = 0.3;      ///< noise is averaged over about this length
  double max_hole_m = 0.4;       ///< wider gaps between samples stay holes
  double sample_area_m2 = 0.01;  ///< that one sample stands for where the data is full
};

/// Screened Poisson surface of a height field: the heights whose gradients are the samples' slopes
/// and whose values are the samples' heights, in the sense of least squares,
///
///   min  sum_edges c (dz - slope)^2  +  sum_samples w (z - z_s)^2
///
/// (Kazhdan and Hoppe 2013, with the height in place of the indicator function). The conductance c
/// of an edge falls where the heights step (Geman and McClure's line process): a kerb's edge stays
/// one cell wide and does not bend the pavement. Solved by conjugate gradients, one thread,
/// deterministic. Vertices farther than max_hole_m / 2 from any sample, or outside the data, get no
/// height.
HeightField SolveHeightField(const std::vector<GroundSample>& samples,
                             const Eigen::Vector2f& origin_m, float cell_m, int width, int height,
                             const HeightFieldOptions& options);

}  // namespace scenecalib
