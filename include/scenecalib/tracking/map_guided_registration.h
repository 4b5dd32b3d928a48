#pragma once

#include <Eigen/Core>
#include <map>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/base/timestamp.h"
#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/sensor/image_pose.h"
#include "scenecalib/tracking/patch_registration.h"
#include "scenecalib/tracking/plane_warp.h"
#include "scenecalib/tracking/track.h"

namespace scenecalib {

/// The surface that a track's scene point lies on.
struct TrackPlane : MapPlane {
  /// Half edge of the patch of the reference view that shows this surface alone; 0: not known.
  int radius_px = 0;
};

struct MapGuidedOptions {
  int radius_px = 10;
  int max_iterations = 12;
  double convergence_px = 0.01;
  double min_ncc = 0.85;
  double max_scale = 2.5;
  double max_shift_px = 1.0;
  int max_extension = 20;
  double max_extension_shift_px = 2.5;
  double min_extension_ncc = 0.9;
  double max_sigma_px = 0.2;
  double sigma_floor_px = 0.02;
  double noise_correlation = 4.0;
  int min_observations = 3;

  void Visit(OptionVisitor& v) {
    v.Field("radius_px", &radius_px, {3, 40}, "half edge of the patch");
    v.Field("max_iterations", &max_iterations, {1, 100}, "Gauss-Newton steps");
    v.Field("convergence_px", &convergence_px, {1e-5, 1}, "step that ends the iteration");
    v.Field("min_ncc", &min_ncc, {-1, 1}, "correlation below which an observation is dropped");
    v.Field("max_scale", &max_scale, {1.05, 10},
            "largest change of scale, in any direction, between an observation and its reference");
    v.Field("max_shift_px", &max_shift_px, {0.05, 20},
            "how far an observation may move from where the tracker left it");
    v.Field("max_extension", &max_extension, {0, 1000},
            "images by which a track may be extended at either end; 0 extends none");
    v.Field("max_extension_shift_px", &max_extension_shift_px, {0.05, 50},
            "how far a new observation may lie from where map and calibration expect it, beyond "
            "what its neighbour in time already showed");
    v.Field("min_extension_ncc", &min_extension_ncc, {-1, 1},
            "correlation that a new observation needs");
    v.Field("max_sigma_px", &max_sigma_px, {0.01, 10},
            "observations less certain than this, in any direction, are dropped");
    v.Field("sigma_floor_px", &sigma_floor_px, {0, 1},
            "error of a registration that its residual does not show, added to its covariance");
    v.Field("noise_correlation", &noise_correlation, {1, 100},
            "by how much neighbouring residuals' correlation inflates the covariance");
    v.Field("min_observations", &min_observations, {2, 1000}, "shorter tracks are dropped");
  }
};

/// Outcome of RegisterThroughMap.
struct MapGuidedTracks {
  /// As the tracks given, in the same order; without observations where a track was dropped.
  std::vector<Track> tracks;
  int num_tracks_dropped = 0;
  int num_observations_dropped = 0;
  int num_observations_added = 0;
};

/// How the surroundings of a pixel in one view of a plane appear in another view, to second order:
/// pixel -> ray -> plane -> pixel through the camera model, which holds the plane's perspective and
/// the lens's distortion alike. None when a ray misses the plane or a point leaves the model.
std::optional<PatchWarp> WarpThroughPlane(const CameraModel& model, const TrackPlane& plane,
                                          const ImagePose& reference,
                                          const Eigen::Vector2d& reference_px,
                                          const ImagePose& other, int radius_px);

/// Registers every observation once more against its track's reference view, now with the warp that
/// the map, the trajectory and the current calibration predict (Eq. 4, within one camera) and only
/// shift, gain and bias free. An affine window on a slanted surface is biased along the flow,
/// because the second-order term of the perspective does not average out; this one is not.
/// Where tracks end too early they are extended to images in which the prediction proves right.
///
/// `planes` is parallel to `tracks`. `poses` are those of the images by their stamps; images
/// without a pose are left out. The model must carry the current intrinsics (WithTunable). Parallel
/// over tracks; the result does not depend on the number of threads.
MapGuidedTracks RegisterThroughMap(const std::vector<Track>& tracks,
                                   const std::vector<TrackPlane>& planes, const CameraModel& model,
                                   const std::map<Timestamp, ImagePose>& poses,
                                   const std::map<Timestamp, cv::Mat>& images,
                                   const MapGuidedOptions& options);

}  // namespace scenecalib
