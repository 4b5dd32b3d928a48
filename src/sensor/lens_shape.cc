#include "scenecalib/sensor/lens_shape.h"

#include <cmath>

#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

bool IsFtheta(const CameraIntrinsics& intrinsics) { return intrinsics.model == "ftheta"; }

}  // namespace

double FocalAtAxisPx(const CameraModel& model) {
  constexpr double kAngle_rad = 1e-4;
  const auto pixel = model.ProjectTuned({std::sin(kAngle_rad), 0.0, std::cos(kAngle_rad)},
                                        model.tunable(), nullptr);
  return pixel ? (pixel->x() - model.tunable().principal_point_px.x()) / kAngle_rad : 0.0;
}

double RadialCoefficient(const CameraModel& model) {
  const CameraIntrinsics intrinsics = model.intrinsics();
  return IsFtheta(intrinsics) ? intrinsics.polynomial_px[2] / intrinsics.polynomial_px[0]
                              : intrinsics.distortion[0];
}

Result<CameraModelPtr> WithRadialChange(const CameraModel& model, double change) {
  CameraIntrinsics changed = model.intrinsics();
  if (IsFtheta(changed)) {
    changed.polynomial_px[2] += change * changed.polynomial_px[0];
  } else {
    changed.distortion[0] += change;
  }
  return CreateCameraModel(changed);
}

}  // namespace scenecalib
