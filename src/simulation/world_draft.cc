#include "world_draft.h"

namespace scenecalib {

WorldDraft::WorldDraft(const WorldLayout& layout, const RoadCurve& road, Random random)
    : layout_(layout), road_(road), random_(random), kerb_m_(random_.Uniform(0.1, 0.15)) {
  const double azimuth = random_.Uniform(0.0, 2.0 * M_PI);
  const double elevation = random_.Uniform(0.65, 1.05);
  world_.towards_sun = {std::cos(elevation) * std::cos(azimuth),
                        std::cos(elevation) * std::sin(azimuth), std::sin(elevation)};
}

std::uint32_t WorldDraft::NewSurface(Material material, const Eigen::Vector3f& albedo) {
  Surface surface;
  surface.material = material;
  surface.albedo = albedo;
  surface.seed = static_cast<std::uint32_t>(random_.NextBits());
  surface.object_id = NextObject();
  return world_.mesh.AddSurface(surface);
}

/// Height of the ground above the hills at an offset.
double WorldDraft::GroundHeight(double s, double d) const {
  const double half = layout_.road_half_width_m;
  const double side = std::abs(d);
  const double crown = -0.0025 * std::min(side, half) * std::min(side, half);
  double height = crown + road_.BumpHeight(s, d);
  if (side > half + 1e-6) height += kerb_m_ + 0.015 * (side - half);
  if (side > layout_.sidewalk_end_m && layout_.ground_roughness > 0.0) {
    height += layout_.ground_roughness * road_.BumpHeight(1.3 * s + 500.0, 1.3 * d);
  }
  return height;
}

Eigen::Vector3d WorldDraft::Ground(double s, double d, double above_m) const {
  const double curvature = road_.Curvature(s);
  double clamped = d;
  if (curvature * d > 0.85) clamped = 0.85 / curvature;
  return road_.Point(s, clamped, GroundHeight(s, d) + above_m);
}

void WorldDraft::AddFootprint(double s0, double s1, double d0, double d1) {
  footprints_.push_back(
      {{std::min(s0, s1), std::max(s0, s1)}, {std::min(d0, d1), std::max(d0, d1)}});
}

bool WorldDraft::IsBuiltOn(double s, double d, double radius_m) const {
  return std::any_of(footprints_.begin(), footprints_.end(), [&](const Footprint& f) {
    return s > f.s.low - radius_m && s < f.s.high + radius_m && d > f.d.low - radius_m &&
           d < f.d.high + radius_m;
  });
}

}  // namespace scenecalib
