#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "scenecalib/geometry/rigid3.h"

namespace scenecalib {

/// Cross-product matrix: Hat(a) * b == a.cross(b).
inline Eigen::Matrix3d Hat(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

/// Rotation by |rotation_vector| radians about its direction.
Eigen::Quaterniond ExpSo3(const Eigen::Vector3d& rotation_vector_rad);

/// Inverse of ExpSo3, with an angle in [0, pi].
Eigen::Vector3d LogSo3(const Eigen::Quaterniond& rotation);

/// Left Jacobian of SO(3): Exp(v + d) = Exp(J_l(v) d) Exp(v) to first order.
Eigen::Matrix3d LeftJacobianSo3(const Eigen::Vector3d& rotation_vector_rad);
Eigen::Matrix3d LeftJacobianInverseSo3(const Eigen::Vector3d& rotation_vector_rad);

/// Right Jacobian of SO(3): Exp(v + d) = Exp(v) Exp(J_r(v) d) to first order.
inline Eigen::Matrix3d RightJacobianSo3(const Eigen::Vector3d& v) { return LeftJacobianSo3(-v); }
inline Eigen::Matrix3d RightJacobianInverseSo3(const Eigen::Vector3d& v) {
  return LeftJacobianInverseSo3(-v);
}

/// Moves from `a` (fraction 0) to `b` (fraction 1): slerp of the rotation, linear translation.
Rigid3 InterpolateRigid3(const Rigid3& a, const Rigid3& b, double fraction);

/// Angle of the rotation a^-1 b, radians in [0, pi].
double RotationAngle(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b);

}  // namespace scenecalib
