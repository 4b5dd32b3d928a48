#pragma once

#include <vector>

#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/tracking/track.h"
#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// What verification did.
struct VerificationEvidence {
  int num_pairs_checked = 0;    ///< of images
  int num_pairs_unchecked = 0;  ///< too little motion or too few tracks in common
  int num_tracks_fixed = 0;     ///< to the vehicle
  int num_tracks_rejected = 0;  ///< by the epipolar constraint
  int num_observations_rejected = 0;
  double median_inlier_rms_px = 0.0;  ///< Sampson distance, over the pairs checked
};

/// Drops tracks of things fixed to the vehicle (FindFixedToVehicle, each track against those seen
/// in its middle image), then holds the others against the camera's motion: between images
/// `frame_gap` apart, unit rays must obey one epipolar constraint. Drops tracks that contradict it
/// too often (moving objects, reflections, junctions of edges at different depths) and single
/// observations that always do. Sees neither motion along the epipolar line (a car ahead on a
/// straight road) nor anything while the camera stands still or only turns. Parallel over pairs,
/// deterministic.
VerificationEvidence VerifyTracks(const CameraModel& model, const VerificationOptions& options,
                                  std::vector<Track>* tracks);

/// A feature's motion over some time, for FindFixedToVehicle.
struct FeatureMotion {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double extent_px = 0.0;  ///< largest distance from the first sighting
  double duration_s = 0.0;
};

/// Which features stayed where they were while those around them moved: the vehicle's own bonnet,
/// mirrors, dirt on the lens, a fisheye's rim. Distant points in the direction of travel stay too,
/// but so do their neighbours.
std::vector<bool> FindFixedToVehicle(const std::vector<FeatureMotion>& features,
                                     const VerificationOptions& options);

}  // namespace scenecalib
