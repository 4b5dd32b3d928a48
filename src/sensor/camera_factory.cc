#include "scenecalib/sensor/camera_factory.h"

#include <cmath>
#include <sstream>

#include "scenecalib/sensor/equidistant_camera.h"
#include "scenecalib/sensor/ftheta_camera.h"
#include "scenecalib/sensor/pinhole_camera.h"

namespace scenecalib {
namespace {

constexpr int kMaxSizePx = 65536;

Status CheckSize(const std::string& model, const std::string& key, int size_px) {
  if (size_px >= 1 && size_px <= kMaxSizePx) return Status::Ok();
  return Status::InvalidArgument(model + ": " + key + " is " + std::to_string(size_px) +
                                 ", must be in [1, " + std::to_string(kMaxSizePx) + "]");
}

/// A cropped image's principal point may lie outside it, but not by more than its size.
Status CheckPrincipalPoint(const CameraIntrinsics& intrinsics) {
  const int sizes_px[] = {intrinsics.width_px, intrinsics.height_px};
  for (int axis = 0; axis < 2; ++axis) {
    const double value = intrinsics.principal_point_px[axis];
    if (value >= -sizes_px[axis] && value <= 2.0 * sizes_px[axis]) continue;  // false for NaN
    std::ostringstream message;
    message << intrinsics.model << ": principal_point_px[" << axis << "] is " << value
            << ", must be in [" << -sizes_px[axis] << ", " << 2 * sizes_px[axis] << "]";
    return Status::InvalidArgument(message.str());
  }
  return Status::Ok();
}

}  // namespace

Result<CameraModelPtr> CreateCameraModel(const CameraIntrinsics& intrinsics) {
  const std::string& model = intrinsics.model;
  SCENECALIB_RETURN_IF_ERROR(CheckSize(model, "width_px", intrinsics.width_px));
  SCENECALIB_RETURN_IF_ERROR(CheckSize(model, "height_px", intrinsics.height_px));
  SCENECALIB_RETURN_IF_ERROR(CheckPrincipalPoint(intrinsics));
  if (model == "ftheta") return FthetaCamera::Create(intrinsics);
  if (model == "equidistant") return EquidistantCamera::Create(intrinsics);
  if (model == "plumb_bob" || model == "rational_polynomial") {
    return PinholeCamera::Create(intrinsics);
  }
  return Status::InvalidArgument("camera model is '" + model +
                                 "', must be ftheta, plumb_bob, rational_polynomial or "
                                 "equidistant");
}

}  // namespace scenecalib
