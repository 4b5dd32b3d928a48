#include "patch_support.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

namespace scenecalib {
namespace {

/// Rings of rays around the patch's centre, as shares of its half edge.
constexpr std::array<double, 4> kRings = {0.4, 0.6, 0.8, 1.0};
constexpr int kRaysPerRing = 8;
constexpr double kRingX[kRaysPerRing] = {-1, 0, 1, -1, 1, -1, 0, 1};
constexpr double kRingY[kRaysPerRing] = {-1, -1, -1, 0, 0, 1, 1, 1};
/// What lies farther off the plane than this is another surface: well above the map's errors, and
/// at 10 m, over a metre of driving, worth a tenth of a pixel of a camera of 700 px/rad.
constexpr double kMaxRelief_m = 0.03;
constexpr double kMaxRange_m = 100.0;

bool IsOnPlane(const std::optional<RayHit>& hit, const TrackPlane& plane) {
  return hit && std::abs(plane.normal_in_map.dot(hit->point_in_map_m - plane.point_in_map_m)) <
                    kMaxRelief_m;
}

}  // namespace

std::vector<int> RadiiOnPlane(const std::vector<PatchOnSurface>& patches, const CameraModel& model,
                              const RayCaster& caster, int radius_px) {
  std::vector<Ray> rays;
  std::vector<bool> is_seen;
  rays.reserve(patches.size() * kRings.size() * kRaysPerRing);
  for (const PatchOnSurface& patch : patches) {
    for (const double ring : kRings) {
      for (int k = 0; k < kRaysPerRing; ++k) {
        const Eigen::Vector2d offset_px(ring * radius_px * kRingX[k], ring * radius_px * kRingY[k]);
        const auto ray = model.Unproject(patch.pixel + offset_px);
        is_seen.push_back(ray.has_value());
        rays.push_back({patch.map_from_camera.translation,
                        patch.map_from_camera.rotation * ray.value_or(Eigen::Vector3d::UnitZ())});
      }
    }
  }
  const std::vector<std::optional<RayHit>> hits = caster.Cast(rays, kMaxRange_m);
  std::vector<int> radii;
  std::size_t i = 0;
  for (const PatchOnSurface& patch : patches) {
    int radius = 0;
    bool is_clean = true;
    for (const double ring : kRings) {
      for (int k = 0; k < kRaysPerRing; ++k, ++i) {
        is_clean = is_clean && is_seen[i] && IsOnPlane(hits[i], patch.plane);
      }
      if (is_clean) radius = static_cast<int>(std::lround(ring * radius_px));
    }
    radii.push_back(radius);
  }
  return radii;
}

TiedTracks DropTracksAtEdges(const std::vector<int>& indices,
                             const std::vector<PatchOnSurface>& patches, const CameraModel& model,
                             const RayCaster& caster, int radius_px, std::vector<Track>* tracks) {
  const std::vector<int> radii = RadiiOnPlane(patches, model, caster, radius_px);
  TiedTracks tied;
  for (std::size_t i = 0; i < indices.size(); ++i) {
    Track& track = (*tracks)[indices[i]];
    if (radii[i] == 0) {
      track.observations.clear();
      continue;
    }
    tied.indices.push_back(indices[i]);
    tied.tracks.push_back(track);
    tied.planes.push_back(patches[i].plane);
    tied.planes.back().radius_px = radii[i];
  }
  return tied;
}

}  // namespace scenecalib
