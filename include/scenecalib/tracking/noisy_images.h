#pragma once

#include <map>
#include <opencv2/core.hpp>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/tracking/image_quality.h"
#include "scenecalib/tracking/image_store.h"
#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// True where noise drowns what registration compares: images taken in the dark.
bool IsNoisy(const ImageQuality& quality, const NoisyImageOptions& options);

/// The options as they are fit for images that Smooth made.
TrackingOptions ForNoisyImages(const TrackingOptions& options);

/// The quality of such images: their noise is given as what independent noise would leave in a
/// smooth reading (patch_registration.h), which is what registration makes of it.
ImageQuality AfterSmoothing(const ImageQuality& quality, const NoisyImageOptions& options);

/// Adds copies of the images, each under a Gaussian of that deviation: registration compares
/// gradients, and those of single pixels are noise. Fails as ImageStore::Add.
Status Smooth(const std::map<Timestamp, cv::Mat>& images, double blur_px, ImageStore* smoothed);

}  // namespace scenecalib
