#pragma once

#include <Eigen/Core>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// A camera's parameters as one vector: shifts right, down, forward, turns about the same axes,
/// s_f, u_0 (x, y), time offset.
constexpr int kNumCameraParameters = 10;
using CameraMatrix = Eigen::Matrix<double, kNumCameraParameters, kNumCameraParameters>;

/// One standard deviation of every parameter of a camera, in the camera frame's axes.
struct CameraStddev {
  Eigen::Vector3d translation_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d rotation_rad = Eigen::Vector3d::Zero();
  double focal_scale = 0.0;
  Eigen::Vector2d principal_point_px = Eigen::Vector2d::Zero();
  double time_offset_s = 0.0;
  /// Between the parameters; those that were held correlate with none. Not part of the file.
  CameraMatrix correlation = CameraMatrix::Identity();
};

/// Share of perturbed poses that look better than the calibrated one (IV-A), per axis of the camera
/// frame: x right, y down, z forward; roll turns about forward, pitch about right, yaw about down.
struct MiscalibrationRate {
  double x = 0.0, y = 0.0, z = 0.0, roll = 0.0, pitch = 0.0, yaw = 0.0;
};

/// The `quality` block of one camera.
struct CameraQuality {
  bool accepted = false;
  std::vector<std::string> reasons;  ///< why not accepted, or what to be careful about
  int num_tracks = 0;
  int num_inlier_tracks = 0;
  int num_cross_camera_matches = 0;
  double rms_before_px = 0.0;
  double rms_after_px = 0.0;
  CameraStddev stddev;
  /// Absent until evaluated.
  std::optional<MiscalibrationRate> miscalibration_rate_before;
  std::optional<MiscalibrationRate> miscalibration_rate_after;
};

/// A calibrated rig: the output file. A camera that was not accepted has its initial values.
struct CalibrationResult {
  Rig rig;
  bool accepted = false;  ///< every camera accepted
  std::vector<std::string> reasons;
  std::vector<CameraQuality> cameras;  ///< parallel to rig.cameras
};

}  // namespace scenecalib
