#pragma once

#include <map>
#include <opencv2/core.hpp>
#include <vector>

#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/tracking/reference_registration.h"
#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// What an extension did.
struct ExtensionEvidence {
  int num_observations_added = 0;
  int num_tracks_absorbed = 0;  ///< that turned out to be a piece of a longer one
};

/// Carries tracks on beyond both ends: a feature is visible before it was detected and often after
/// it was lost. From image to image the other tracks' motion predicts where it goes (SceneFlow);
/// the patch of its own reference view then has to match there as in RegisterAgainstReference. A
/// few images may be missed in between. Where the scale has changed too much for it, a certain
/// sighting on the way takes the reference view's place, up to three times; the covariances of what
/// is found with it hold its own too. Where a longer track comes upon a shorter one, both follow
/// the same thing, and the longer one takes over its observations.
///
/// Parallel over tracks, deterministic. Tracks left with fewer than `min_observations` are dropped.
ExtensionEvidence ExtendTracks(const CameraModel& model, const std::map<Timestamp, cv::Mat>& images,
                               const cv::Mat& mask, const ImageQuality& quality,
                               const TrackingOptions& options,
                               std::vector<RegisteredTrack>* tracks);

}  // namespace scenecalib
