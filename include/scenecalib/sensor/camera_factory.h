#pragma once

#include "scenecalib/base/status.h"
#include "scenecalib/sensor/camera_model.h"

namespace scenecalib {

/// Builds the camera that `intrinsics.model` names. InvalidArgument, naming the model, the key, the
/// value and the bound, for an unknown model, a wrong number of coefficients, a number that is not
/// finite or out of range, and for a polynomial that stops being monotonic inside the image: such a
/// model folds and has no inverse there.
Result<CameraModelPtr> CreateCameraModel(const CameraIntrinsics& intrinsics);

}  // namespace scenecalib
