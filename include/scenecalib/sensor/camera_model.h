#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "scenecalib/base/status.h"

namespace scenecalib {

/// The intrinsic parameters that a calibration tunes (Appendix B): f-theta evaluates f(s_f theta),
/// the models of ROS multiply both focal lengths by s_f; u_0 is the principal point.
struct TunableIntrinsics {
  double focal_scale = 1.0;                                      ///< s_f
  Eigen::Vector2d principal_point_px = Eigen::Vector2d::Zero();  ///< u_0
};

/// What a rig file says about a lens (docs/ros_api.md). `focal_px` (fx, fy) and `distortion` belong
/// to the models of ROS, `polynomial_px` (k1..k5, px per radian^i) to ftheta; the others are empty.
struct CameraIntrinsics {
  std::string model;  ///< "ftheta", "plumb_bob", "rational_polynomial" or "equidistant"
  int width_px = 0;
  int height_px = 0;
  std::vector<double> focal_px;
  Eigen::Vector2d principal_point_px = Eigen::Vector2d::Zero();
  std::vector<double> polynomial_px;
  std::vector<double> distortion;  ///< in the order of sensor_msgs/CameraInfo D
};

/// Derivatives of a projected pixel.
struct ProjectionJacobians {
  Eigen::Matrix<double, 2, 3> pixel_by_point;       ///< by the point in the camera frame, px/m
  Eigen::Matrix<double, 2, 3> pixel_by_intrinsics;  ///< columns: s_f, cx, cy
};

/// Derivatives of an unprojected unit ray.
struct UnprojectionJacobians {
  Eigen::Matrix<double, 3, 2> ray_by_pixel;
  Eigen::Matrix<double, 3, 3> ray_by_intrinsics;  ///< columns: s_f, cx, cy
};

/// A central camera: pixels <-> unit rays in the camera's optical frame (x right, y down, z
/// forward, REP 103). Pixel (0, 0) is the centre of the top-left pixel, so the image covers
/// [-0.5, width - 0.5) x [-0.5, height - 0.5). Rays, not normalised image coordinates, are the
/// interface, because a fisheye sees behind z = 0. Immutable; safe to share between threads.
class CameraModel {
 public:
  virtual ~CameraModel() = default;

  /// "ftheta", "plumb_bob", "rational_polynomial" or "equidistant", as in the rig file.
  virtual std::string name() const = 0;
  /// What CreateCameraModel (sensor/camera_factory.h) would build the same model from.
  virtual CameraIntrinsics intrinsics() const = 0;
  int width_px() const { return width_px_; }
  int height_px() const { return height_px_; }
  /// The model's own tunable parameters: s_f = 1 and its principal point.
  const TunableIntrinsics& tunable() const { return tunable_; }

  /// True inside the image's extent (see the class comment).
  bool IsInImage(const Eigen::Vector2d& pixel) const {
    return pixel.x() >= -0.5 && pixel.y() >= -0.5 && pixel.x() < width_px_ - 0.5 &&
           pixel.y() < height_px_ - 0.5;
  }

  /// Pixel of a point in the camera frame (any positive scale). None when the point lies outside
  /// the model's domain (behind the camera, beyond the polynomial's monotonic range, at the origin)
  /// or its pixel outside the image.
  std::optional<Eigen::Vector2d> Project(const Eigen::Vector3d& point_in_camera,
                                         ProjectionJacobians* jacobians = nullptr) const {
    const auto pixel = ProjectTuned(point_in_camera, tunable_, jacobians);
    if (!pixel || !IsInImage(*pixel)) return std::nullopt;
    return pixel;
  }

  /// Unit ray through a pixel. None outside the model's domain (e.g. beyond the image circle).
  std::optional<Eigen::Vector3d> Unproject(const Eigen::Vector2d& pixel,
                                           UnprojectionJacobians* jacobians = nullptr) const {
    return UnprojectTuned(pixel, tunable_, jacobians);
  }

  /// As Project, with other tunable intrinsics and without the image's border: for solvers, where a
  /// pixel a little outside the image is still a meaningful residual. None unless s_f > 0.
  virtual std::optional<Eigen::Vector2d> ProjectTuned(const Eigen::Vector3d& point_in_camera,
                                                      const TunableIntrinsics& tunable,
                                                      ProjectionJacobians* jacobians) const = 0;

  /// As Unproject, with other tunable intrinsics.
  virtual std::optional<Eigen::Vector3d> UnprojectTuned(const Eigen::Vector2d& pixel,
                                                        const TunableIntrinsics& tunable,
                                                        UnprojectionJacobians* jacobians) const = 0;

  /// The model with the tunable parameters folded into its own (f-theta: k_i s_f^i; otherwise focal
  /// lengths times s_f). InvalidArgument when the result is not a valid camera.
  virtual Result<std::shared_ptr<const CameraModel>> WithTunable(
      const TunableIntrinsics& tunable) const = 0;

  /// Largest angle between a valid ray and the optical axis over the image, radians.
  double max_theta_rad() const { return max_theta_rad_; }

 protected:
  CameraModel(int width_px, int height_px, const Eigen::Vector2d& principal_point_px)
      : width_px_(width_px), height_px_(height_px) {
    tunable_.principal_point_px = principal_point_px;
  }

  int width_px_;
  int height_px_;
  TunableIntrinsics tunable_;
  double max_theta_rad_ = 0.0;
};

using CameraModelPtr = std::shared_ptr<const CameraModel>;

}  // namespace scenecalib
