#include "scenecalib/geometry/so3.h"

#include <cmath>

namespace scenecalib {
namespace {

constexpr double kSmallAngle = 1e-5;  // below it the Taylor series is exact to double precision

}  // namespace

Eigen::Quaterniond ExpSo3(const Eigen::Vector3d& rotation_vector_rad) {
  const double angle = rotation_vector_rad.norm();
  const double half = 0.5 * angle;
  const double scale = angle < kSmallAngle ? 0.5 - angle * angle / 48.0 : std::sin(half) / angle;
  Eigen::Quaterniond q;
  q.w() = std::cos(half);
  q.vec() = scale * rotation_vector_rad;
  return q.normalized();
}

Eigen::Vector3d LogSo3(const Eigen::Quaterniond& rotation) {
  Eigen::Quaterniond q = rotation;
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  const double sine = q.vec().norm();
  if (sine < kSmallAngle)
    return 2.0 / q.w() * (1.0 - sine * sine / (3.0 * q.w() * q.w())) * q.vec();
  return 2.0 * std::atan2(sine, q.w()) / sine * q.vec();
}

Eigen::Matrix3d LeftJacobianSo3(const Eigen::Vector3d& v) {
  const double angle = v.norm();
  const Eigen::Matrix3d hat = Hat(v);
  if (angle < kSmallAngle) return Eigen::Matrix3d::Identity() + 0.5 * hat + hat * hat / 6.0;
  const double a2 = angle * angle;
  return Eigen::Matrix3d::Identity() + (1.0 - std::cos(angle)) / a2 * hat +
         (angle - std::sin(angle)) / (a2 * angle) * hat * hat;
}

Eigen::Matrix3d LeftJacobianInverseSo3(const Eigen::Vector3d& v) {
  const double angle = v.norm();
  const Eigen::Matrix3d hat = Hat(v);
  if (angle < kSmallAngle) return Eigen::Matrix3d::Identity() - 0.5 * hat + hat * hat / 12.0;
  const double half = 0.5 * angle;
  const double c = (1.0 - half / std::tan(half)) / (angle * angle);
  return Eigen::Matrix3d::Identity() - 0.5 * hat + c * hat * hat;
}

Rigid3 InterpolateRigid3(const Rigid3& a, const Rigid3& b, double fraction) {
  return {a.rotation.slerp(fraction, b.rotation),
          (1.0 - fraction) * a.translation + fraction * b.translation};
}

double RotationAngle(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b) {
  return LogSo3(a.conjugate() * b).norm();
}

}  // namespace scenecalib
