#pragma once

#include <Eigen/Core>

#include "scenecalib/simulation/mesh.h"

namespace scenecalib {

/// Linear reflectance (blue, green, red) of a surface at texture coordinates uv_m, averaged over a
/// pixel that covers footprint_m along u and v. Detail finer than two pixels fades out and edges of
/// markings and bricks are integrated exactly, so images do not alias.
Eigen::Vector3f EvaluateTexture(const Surface& surface, const Eigen::Vector2f& uv_m,
                                const Eigen::Vector2f& footprint_m);

/// Share of [x - footprint / 2, x + footprint / 2] that a train of pulses covers: each `width` long
/// from every multiple of `period`. The exact box filter.
float FilteredPulses(float x, float period, float width, float footprint);

/// Share of [x - footprint / 2, x + footprint / 2] that lies within [low, high].
float FilteredBand(float x, float low, float high, float footprint);

/// Half the road's width and where its markings are, shared by geometry and texture.
struct RoadLayout {
  static constexpr double kHalfWidthM = 5.4;
  static constexpr double kLaneM = 3.3;  ///< a driving lane; parked cars stand beyond it
};

}  // namespace scenecalib
