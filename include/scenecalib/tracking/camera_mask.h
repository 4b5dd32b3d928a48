#pragma once

#include <opencv2/core.hpp>

#include "scenecalib/base/status.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// The camera's mask image as CV_8UC1: 0 where nothing of the scene is seen, 255 elsewhere; empty
/// when the rig names none. NotFound when the file cannot be read, InvalidArgument when its size is
/// not the camera's (unknown without intrinsics: not checked) or when it leaves nothing to see; the
/// message names camera and file.
Result<cv::Mat> ReadCameraMask(const CameraConfig& camera);

}  // namespace scenecalib
