#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "scenecalib/base/timestamp.h"

namespace scenecalib {

/// One sighting of a track's scene point.
struct TrackObservation {
  Timestamp stamp_ns = 0;  ///< the image's stamp, camera clock (without time_offset_s)
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  /// Covariance of the pixel from the patch's structure tensor and registration residual, px^2.
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Identity();
};

/// Pixels of one scene point over time in one camera, oldest first; at most one per image.
struct Track {
  std::int64_t id = 0;  ///< unique within the camera
  std::vector<TrackObservation> observations;
  /// Index into `observations` of the view that the others were registered against, directly or
  /// (far from it) through another one.
  int reference = 0;
  /// Half edge of the patch beyond which the reference view is known to hold other things, a depth
  /// edge; 0: nothing is known.
  int patch_radius_px = 0;
};

/// Evidence of one image's tracking.
struct FrameTracking {
  Timestamp stamp_ns = 0;
  int num_tracked = 0;   ///< carried over from the image before
  int num_rejected = 0;  ///< lost by forward-backward, appearance or geometry
  int num_new = 0;
  double mean_brightness = 0.0;  ///< grey value 0..255
  bool is_black = false;         ///< nothing to see at all
};

}  // namespace scenecalib
