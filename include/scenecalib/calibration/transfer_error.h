#pragma once

#include <Eigen/Core>
#include <optional>

#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/sensor/camera_model.h"

namespace scenecalib {

using Vector6d = Eigen::Matrix<double, 6, 1>;

/// Parameters of one camera, as the solver moves them: `base` is where this solve began and the
/// deltas are what it changes, so that every block is a plain vector space,
///   lidar_from_camera = (Exp(rotation_delta_rad) * base.rotation, base.translation +
///   translation_delta_m).
struct CameraParameters {
  const CameraModel* model = nullptr;  ///< not owned; outlives the parameters
  Rigid3 base_lidar_from_camera;
  Eigen::Vector3d rotation_delta_rad = Eigen::Vector3d::Zero();
  Eigen::Vector3d translation_delta_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d intrinsics = Eigen::Vector3d(1.0, 0.0, 0.0);  ///< s_f, cx, cy
  double time_offset_delta_s = 0.0;
  double rolling_shutter_line_time_s = 0.0;  ///< known, not solved for; 0: a global shutter

  Rigid3 LidarFromCamera() const;
  TunableIntrinsics Intrinsics() const { return {intrinsics[0], intrinsics.tail<2>()}; }
  /// Folds the pose deltas into the base.
  void Rebase();
};

/// One sighting as the loss sees it.
struct TransferView {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Rigid3 map_from_lidar;  ///< at the image's time, from the lidar trajectory
  /// Body twist at that time (angular rate rad/s, then velocity m/s, lidar frame): what a change of
  /// the camera's time offset does to the pose, to first order.
  Vector6d twist_in_lidar = Vector6d::Zero();
};

/// A view's camera in the map, with the correction and the time offset's change applied.
struct ViewPose {
  Eigen::Matrix3d map_from_camera;
  Eigen::Vector3d camera_in_map_m;
};
ViewPose PoseOf(const TransferView& view, const CameraParameters& camera,
                const Vector6d& correction);

/// How that pose moves with the parameters: its turn (rad, the map's axes) in the upper and its
/// shift (m) in the lower three rows, by rotation, translation and correction (rotation, then
/// translation), three columns each.
using ViewMotion = Eigen::Matrix<double, 6, 12>;
ViewMotion MotionOf(const TransferView& view, const CameraParameters& camera,
                    const Vector6d& correction);

/// Derivatives of the residual by the poses of both views; columns are turn, shift and the
/// intrinsics s_f, cx, cy.
struct PoseJacobians {
  Eigen::Matrix<double, 2, 9> source;
  Eigen::Matrix<double, 2, 9> target;
  Eigen::Matrix2d by_source_pixel;
  Eigen::Vector2d by_plane_offset;  ///< by a shift of the plane along its normal, px/m
};

/// What a camera sees in one pixel: all transfers from there share it.
struct SourceRay {
  std::optional<Eigen::Vector3d> direction;  ///< in the camera's frame; none outside the lens
  UnprojectionJacobians jacobians;           ///< only where asked for
};
SourceRay RayOf(const CameraParameters& camera, const Eigen::Vector2d& pixel,
                bool with_derivatives);

/// EvaluateTransfer between views whose poses are known, along a ray that is known: many transfers
/// share them. `jacobians` need the ray's.
bool EvaluatePosedTransfer(const SourceRay& ray, const ViewPose& source,
                           const Eigen::Vector2d& target_pixel,
                           const CameraParameters& target_camera, const ViewPose& target,
                           const Eigen::Vector3d& plane_point_in_map_m,
                           const Eigen::Vector3d& plane_normal_in_map, Eigen::Vector2d* residual_px,
                           PoseJacobians* jacobians);

/// Derivatives of the 2-vector residual by one view's quantities.
struct TransferViewJacobians {
  Eigen::Matrix<double, 2, 3> by_rotation;
  Eigen::Matrix<double, 2, 3> by_translation;
  Eigen::Matrix<double, 2, 3> by_intrinsics;  ///< s_f, cx, cy
  Eigen::Matrix<double, 2, 6> by_correction;  ///< rotation, then translation
};

/// Everything a weight needs to know of the transfer.
struct TransferJacobians {
  TransferViewJacobians source;
  TransferViewJacobians target;
  Eigen::Matrix2d by_source_pixel;
  Eigen::Vector2d by_plane_offset;  ///< by a shift of the plane along its normal, px/m
};

/// Ray-plane transfer error, Eq. (1)-(2): the source pixel's ray meets the plane in x, and the
/// residual is the projection of x into the target view minus the pixel seen there, in px.
///
/// Differs from the paper: T_L^W(t) carries a small correction c(t) = (rotation, translation) in
/// the lidar frame, map_from_lidar * (Exp(c_r), c_t), because the trajectory's error over the life
/// of a track limits the accuracy of the result (docs/math.md, docs/accuracy.md). Zero is the
/// paper.
///
/// Returns false (and leaves the outputs alone) when the ray does not meet the plane in front of
/// the source camera or the point cannot be projected: never a zero residual. `jacobians` may be
/// null.
bool EvaluateTransfer(const TransferView& source, const CameraParameters& source_camera,
                      const Vector6d& source_correction, const TransferView& target,
                      const CameraParameters& target_camera, const Vector6d& target_correction,
                      const Eigen::Vector3d& plane_point_in_map_m,
                      const Eigen::Vector3d& plane_normal_in_map, Eigen::Vector2d* residual_px,
                      TransferJacobians* jacobians);

}  // namespace scenecalib
