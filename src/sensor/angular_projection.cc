#include "scenecalib/sensor/angular_projection.h"

#include <cassert>

#include "camera_checks.h"

namespace scenecalib {
namespace {

// |p_xy| / |p_z| below which a ray counts as the optical axis: what the series leaves out there is
// below double precision.
constexpr double kOnAxis = 1e-12;

}  // namespace

AngularProjection::AngularProjection(const std::vector<double>& coefficients, double cap_rad,
                                     double fit_radius)
    : degree_(static_cast<int>(coefficients.size())) {
  assert(degree_ >= 1 && degree_ <= kMaxDegree && coefficients[0] > 0.0);
  std::copy(coefficients.begin(), coefficients.end(), coefficients_.begin());
  std::vector<double> derivative;
  for (int i = 0; i < degree_; ++i) derivative.push_back((i + 1) * coefficients[i]);
  const std::vector<double> folds = PositiveRoots(derivative, cap_rad);
  max_argument_ = folds.empty() ? cap_rad : folds.front();
  max_radius_ = (*this)(max_argument_, nullptr);
  const double fit_argument =
      fit_radius >= max_radius_
          ? max_argument_
          : InvertMonotonic(*this, fit_radius, max_argument_, 0.5 * max_argument_);
  approximate_inverse_ = ApproximateInverse(*this, fit_argument);
}

bool AngularProjection::Project(const Eigen::Vector3d& point, double a, bool derivatives,
                                ImagePoint* result) const {
  const Eigen::Vector2d xy = point.head<2>();
  const double z = point.z();
  const double rho = xy.norm();
  if (!(rho > kOnAxis * std::abs(z))) {
    if (!(a > 0.0 && z > 0.0)) return false;
    const double slope = a * coefficients_[0] / z;
    result->q = slope * xy;
    if (derivatives) {
      result->q_by_point << slope, 0.0, 0.0, 0.0, slope, 0.0;
      result->q_by_a = result->q / a;
    }
    return true;
  }
  const double theta = std::atan2(rho, z);
  if (!(a > 0.0 && a * theta <= max_argument_)) return false;
  double slope = 0.0;
  const double radius = (*this)(a * theta, &slope);
  const Eigen::Vector2d d = xy / rho;
  result->q = radius * d;
  if (derivatives) {
    const double squared_range = rho * rho + z * z;
    const double tangential = radius / rho;
    const double radial = a * slope * z / squared_range;
    result->q_by_point.leftCols<2>() =
        (radial - tangential) * d * d.transpose() + tangential * Eigen::Matrix2d::Identity();
    result->q_by_point.col(2) = -a * slope * rho / squared_range * d;
    result->q_by_a = theta * slope * d;
  }
  return true;
}

bool AngularProjection::Unproject(const Eigen::Vector2d& q, double a, bool derivatives,
                                  Ray* result) const {
  const double radius = q.norm();
  if (!(a > 0.0 && radius <= max_radius_)) return false;
  const double x = InvertMonotonic(*this, radius, max_argument_, approximate_inverse_(radius));
  const double theta = x / a;
  if (!(theta <= kPi)) return false;
  const double sine = std::sin(theta);
  const double cosine = std::cos(theta);
  const bool on_axis = theta <= kOnAxis;
  // Near the axis the ray is q / h'(0), whatever the direction e; there sin(theta) / radius is 0/0.
  const double sine_by_radius = on_axis ? 1.0 / (a * coefficients_[0]) : sine / radius;
  result->direction << sine_by_radius * q, cosine;
  if (derivatives) {
    double slope = 0.0;
    (*this)(x, &slope);
    const Eigen::Vector2d e = on_axis ? Eigen::Vector2d::UnitX().eval() : (q / radius).eval();
    Eigen::Vector3d ray_by_theta;
    ray_by_theta << cosine * e, -sine;
    result->ray_by_q = ray_by_theta * e.transpose() / (a * slope);
    result->ray_by_q.topRows<2>() +=
        sine_by_radius * (Eigen::Matrix2d::Identity() - e * e.transpose());
    result->ray_by_a = -theta / a * ray_by_theta;
  }
  return true;
}

}  // namespace scenecalib
