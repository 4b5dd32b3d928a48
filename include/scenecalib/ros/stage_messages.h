#pragma once

#include <scenecalib/Calibration.h>
#include <scenecalib/GetSegment.h>
#include <scenecalib/MapSnapshot.h>

#include <string>

#include "scenecalib/base/status.h"
#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {

// What the nodes hand to each other.

MapSnapshot ToMessage(const SceneMap& map, const std::string& map_frame_id);
/// InvalidArgument when arrays do not fit each other or the trajectory is none.
Result<SceneMap> FromMessage(const MapSnapshot& message);

/// Fills tracks, images (PNG) and evidence; leaves success, message and camera_info.
void FillSegment(const CameraSegment& segment, GetSegmentResponse* response);
/// InvalidArgument when arrays do not fit each other or an image cannot be decoded.
Result<CameraSegment> FromMessage(const GetSegmentResponse& response);

Calibration ToMessage(const CalibrationResult& result, Timestamp stamp_ns);

}  // namespace scenecalib
