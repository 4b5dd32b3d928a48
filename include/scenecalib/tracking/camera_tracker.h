#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/tracking/track.h"
#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// What a camera's images gave in a segment.
struct CameraSegment {
  std::vector<Track> tracks;  ///< verified, sorted by id
  /// Images kept for map-guided re-registration, cross-camera matching and overlays, by stamp.
  std::map<Timestamp, cv::Mat> images;
  /// Those that also came in colour (CV_8UC3, BGR), about one per second, for pictures.
  std::map<Timestamp, cv::Mat> colour_images;
  int num_images_in = 0;
  int num_images_dropped_at_bound = 0;
  int num_images_still = 0;  ///< not kept: nothing had moved (ImageBufferOptions::min_motion_px)
  double mean_brightness = 0.0;
  std::vector<std::string> warnings;  ///< "cam_left: 40 of 66 images are black", ...
};

/// Feature tracks of one camera (III-A, "monocular structure-from-motion"): fed with images as they
/// come, live or from a bag. Not thread-safe. Memory is bounded by TrackingOptions::buffer: at the
/// bound the oldest images and their observations are forgotten and counted.
class CameraTracker {
 public:
  /// `mask` (ReadCameraMask) is zero where nothing of the scene is seen; empty: seen everywhere.
  CameraTracker(std::string name, CameraModelPtr model, const TrackingOptions& options,
                const cv::Mat& mask = cv::Mat());
  ~CameraTracker();
  CameraTracker(CameraTracker&&) noexcept;
  CameraTracker& operator=(CameraTracker&&) noexcept;

  /// InvalidArgument when the size is not the model's, the mask's size is not the images' or the
  /// stamp does not increase (skipped).
  Result<FrameTracking> AddImage(const GrayImage& image);

  /// Forgets everything.
  void Reset();

  /// Everything still buffered: tracks after verification, and the images.
  CameraSegment Segment() const;

  /// The last image with its live tracks drawn (BGR), for the debug topic; empty before any image.
  cv::Mat DebugImage() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace scenecalib
