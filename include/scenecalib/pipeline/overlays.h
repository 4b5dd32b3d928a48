#pragma once

#include <limits>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/base/timestamp.h"
#include "scenecalib/geometry/trajectory.h"
#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/sensor/rig.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {

/// A camera's overlays, several images of the drive one below the other (BGR).
struct CameraOverlays {
  std::string camera;
  cv::Mat before;
  cv::Mat after;
};

/// Overlays of `max_images` images per camera, spread over the drive, with the initial and with the
/// calibrated rig. `segments` is parallel to the rigs' cameras. A camera without an image in the
/// map's time is left out.
Result<std::vector<CameraOverlays>> DrawOverlays(const Rig& initial, const Rig& calibrated,
                                                 const SceneMap& map,
                                                 const std::vector<CameraSegment>& segments,
                                                 int max_images);

/// Which images of a drive to use: times by the lidar clock, both ends included; by default all.
struct ImageWindow {
  Timestamp start_ns = std::numeric_limits<Timestamp>::min();
  Timestamp end_ns = std::numeric_limits<Timestamp>::max();
};

/// Images per camera that colour a map well: one every 15 m, at least 12 and at most 48.
int NumImagesForColour(const Trajectory& map_from_lidar);

/// The colour that the cameras give each map point, 0xRRGGBB, or -1 where none saw it; of several
/// sightings the nearest counts. Cameras without colour give grey. At most `max_images` images per
/// camera are used, spread over the window.
std::vector<int> ColourMap(const Rig& calibrated, const SceneMap& map,
                           const std::vector<CameraSegment>& segments, int max_images,
                           const ImageWindow& window = {});

}  // namespace scenecalib
