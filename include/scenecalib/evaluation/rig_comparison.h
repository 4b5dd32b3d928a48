#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// How far a camera's estimate is from the truth: camera_true_from_camera_estimated =
/// inverse(lidar_from_camera of the truth) * lidar_from_camera of the estimate, in the true camera
/// frame's axes (right, down, forward).
struct CameraError {
  std::string name;
  Eigen::Vector3d rotation_rad = Eigen::Vector3d::Zero();  ///< rotation vector
  Eigen::Vector3d translation_m = Eigen::Vector3d::Zero();
  double time_offset_s = 0.0;  ///< estimate minus truth
  /// Radius on the image 0.1 rad off the axis, estimate by truth, minus one: s_f whatever the
  /// model.
  double focal_scale = 0.0;
  Eigen::Vector2d principal_point_px = Eigen::Vector2d::Zero();  ///< estimate minus truth
  /// Difference of the pixels, end to end: points 5 to 50 m away over the whole true image, placed
  /// by the truth, projected by the estimate. Judges a calibration where principal point and
  /// rotation trade off against each other.
  double reprojection_rms_px = 0.0;
  int num_points = 0;              ///< in the RMS
  int num_unprojected_points = 0;  ///< outside the estimate's domain, hence not in the RMS
};

/// Errors of every camera of `truth`, in its order. NotFound, naming it, when the estimate lacks
/// one; InvalidArgument when a camera has no model.
Result<std::vector<CameraError>> CompareRigs(const Rig& truth, const Rig& estimate);

}  // namespace scenecalib
