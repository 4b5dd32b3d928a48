#pragma once

#include <vector>

#include "scenecalib/calibration/transfer_error.h"
#include "scenecalib/mapping/ray_caster.h"
#include "scenecalib/tracking/map_guided_registration.h"

namespace scenecalib {

/// A reference view whose patch is to be registered through its plane.
struct PatchOnSurface {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Rigid3 map_from_camera;
  TrackPlane plane;
};

/// Half edges of the largest patches, at most `radius_px`, in which the map shows nothing but the
/// patch's own plane; 0 where even the smallest shows something else. A recessed window or the edge
/// of a pillar moves against the wall that it is seen with: a patch that holds both is registered
/// in between, always to the same side. Parallel to `patches`.
std::vector<int> RadiiOnPlane(const std::vector<PatchOnSurface>& patches, const CameraModel& model,
                              const RayCaster& caster, int radius_px);

/// Tracks whose reference patches hold nothing but their planes.
struct TiedTracks {
  std::vector<int> indices;  ///< of the tracks among all
  std::vector<Track> tracks;
  std::vector<TrackPlane> planes;  ///< with the radius that is on the plane
};

/// Of the tracks with these indices, whose reference patches are `patches`, those that lie on their
/// planes. The others lose their observations: at the edge of a plane a patch holds something else
/// too, and every camera would see them move too little.
TiedTracks DropTracksAtEdges(const std::vector<int>& indices,
                             const std::vector<PatchOnSurface>& patches, const CameraModel& model,
                             const RayCaster& caster, int radius_px, std::vector<Track>* tracks);

}  // namespace scenecalib
