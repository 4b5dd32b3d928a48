#pragma once

#include "scenecalib/base/status.h"
#include "scenecalib/sensor/camera_model.h"

namespace scenecalib {

/// Radius on the image per radian off the optical axis, px, at the axis (to its right): compares
/// focal lengths whatever the model and its distortion. 0 where the model has no axis.
double FocalAtAxisPx(const CameraModel& model);

/// The first coefficient by which a lens departs from its ideal, of the radius' cube: k1 of the
/// models of ROS (of tan(theta) for plumb_bob and rational_polynomial, of theta for equidistant),
/// k3 / k1 of ftheta. No unit.
double RadialCoefficient(const CameraModel& model);

/// The model with `change` added to that coefficient and all else as it was. InvalidArgument when
/// such a lens would fold inside the image.
Result<CameraModelPtr> WithRadialChange(const CameraModel& model, double change);

}  // namespace scenecalib
