#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace scenecalib {

/// A rigid transform of 3-space, named target_from_source: it maps the coordinates of a point in
/// `source` to the coordinates of the same point in `target`,
///
///   point_in_target = target_from_source * point_in_source
///                   = rotation * point_in_source + translation   (metres),
///
/// so translation is the origin of `source` seen from `target`, and neighbouring frames cancel:
/// map_from_camera = map_from_lidar * lidar_from_camera. The rotation is a unit quaternion;
/// wherever four numbers are written (files, messages) the order is x, y, z, w.
struct Rigid3 {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Rigid3() = default;
  Rigid3(const Eigen::Quaterniond& q, const Eigen::Vector3d& t)
      : rotation(q.normalized()), translation(t) {}

  static Rigid3 Identity() { return {}; }

  /// source_from_target.
  Rigid3 Inverse() const {
    const Eigen::Quaterniond inverse = rotation.conjugate();
    return {inverse, -(inverse * translation)};
  }

  Eigen::Matrix3d RotationMatrix() const { return rotation.toRotationMatrix(); }

  Eigen::Isometry3d ToIsometry() const {
    Eigen::Isometry3d isometry = Eigen::Isometry3d::Identity();
    isometry.linear() = RotationMatrix();
    isometry.translation() = translation;
    return isometry;
  }
};

inline Eigen::Vector3d operator*(const Rigid3& target_from_source,
                                 const Eigen::Vector3d& point_in_source) {
  return target_from_source.rotation * point_in_source + target_from_source.translation;
}

/// Composition; renormalised, so long products stay rotations.
inline Rigid3 operator*(const Rigid3& c_from_b, const Rigid3& b_from_a) {
  return {c_from_b.rotation * b_from_a.rotation, c_from_b * b_from_a.translation};
}

}  // namespace scenecalib
