#pragma once

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>

#include <optional>

#include "scenecalib/base/status.h"
#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/sensor/measurements.h"

namespace scenecalib {

/// Turns one camera's images into 8-bit grey: mono8, mono16, rgb8, bgr8, rgba8, bgra8, the Bayer
/// patterns, yuv422 (UYVY) and yuv422_yuy2, and JPEG or PNG. One converter per camera, because of
/// mono16: cameras put 10, 12, 14 or 16 significant bits into it without saying how many, so the
/// scale follows the widest value seen so far (it can only widen, mostly within the first image).
/// About once a second the image is kept in colour too, for pictures. Not thread-safe.
class ImageConverter {
 public:
  /// InvalidArgument for an unknown encoding, or data that does not fit size and step.
  Result<GrayImage> Convert(const sensor_msgs::Image& message);
  /// InvalidArgument when the bytes are not an image.
  Result<GrayImage> Convert(const sensor_msgs::CompressedImage& message);

 private:
  bool WantsColour(Timestamp stamp_ns);

  int mono16_bits_ = 8;
  std::optional<Timestamp> last_colour_ns_;
};

/// The camera that a camera_info message describes: distortion_model plumb_bob,
/// rational_polynomial, or equidistant (also spelt fisheye). K and D are of the raw image; binning
/// and region of interest are applied. InvalidArgument naming what is wrong, e.g. an uncalibrated
/// camera (K all zero).
Result<CameraModelPtr> CameraModelFromInfo(const sensor_msgs::CameraInfo& info);

}  // namespace scenecalib
