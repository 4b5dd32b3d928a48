#pragma once

#include <optional>
#include <vector>

#include "scenecalib/association/track_association.h"
#include "scenecalib/calibration/calibration_problem.h"
#include "scenecalib/geometry/trajectory.h"
#include "scenecalib/tracking/track.h"

namespace scenecalib {

/// Where a camera's observations lie in time and space: what bundles and terms are built from.
struct CameraContext {
  int camera = 0;
  const CameraParameters* parameters = nullptr;
  double time_offset_s = 0.0;
  const Trajectory* map_from_lidar = nullptr;
  const TrajectoryCorrection* correction = nullptr;  ///< may be empty
};

/// How much of the tracks a solve uses, and what a surface's plane is worth.
struct TermOptions {
  int max_views_per_track = 12;
  double plane_sigma_floor_m = 0.004;
  double plane_sigma_per_thickness = 0.2;
  double pixel_sigma_floor_px = 0.03;
  void Visit(OptionVisitor& v) {
    v.Field("max_views_per_track", &max_views_per_track, {2, 1000},
            "views of a track used in the loss, evenly spread over its life");
    v.Field("plane_sigma_floor_m", &plane_sigma_floor_m, {0.0, 0.5},
            "uncertainty along its normal that every surface has");
    v.Field("plane_sigma_per_thickness", &plane_sigma_per_thickness, {0.0, 2.0},
            "further uncertainty, as a share of the surface's thickness");
    v.Field("pixel_sigma_floor_px", &pixel_sigma_floor_px, {0.001, 5.0},
            "added in quadrature to each observation's own standard deviation");
  }
};

/// When an observation was made, lidar clock: with a rolling shutter its row tells.
Timestamp StampOf(const CameraContext& context, const TrackObservation& observation);

/// map_from_lidar (uncorrected) and twist at an image stamp; none outside the trajectory.
std::optional<TransferView> ViewAt(const CameraContext& context,
                                   const TrackObservation& observation);

/// Back-projected rays of every track in the map frame, with the trajectory correction applied; an
/// observation outside the trajectory or the camera's domain contributes no ray.
std::vector<std::vector<Ray>> BuildBundles(const CameraContext& context,
                                           const std::vector<Track>& tracks);

/// The star of each accepted track: its reference view against each other view. The reference is
/// the view that the tracker registered the others against, so its pixel defines the point and the
/// noise is in the others. Not whitened yet.
std::vector<TransferTerm> BuildTerms(const CameraContext& context, const std::vector<Track>& tracks,
                                     const std::vector<TrackAssociation>& associations,
                                     const TermOptions& options);

/// At most `max_tracks` of the tracks, long ones first, spread over time and image. The result
/// keeps the order of the input.
std::vector<Track> SelectTracks(const std::vector<Track>& tracks, int max_tracks, int min_views,
                                int width_px, int height_px);

}  // namespace scenecalib
