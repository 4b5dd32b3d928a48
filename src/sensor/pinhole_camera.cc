#include "scenecalib/sensor/pinhole_camera.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "camera_checks.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

// tan(89 degrees): beyond, a pinhole image plane is a matter of rounding.
constexpr double kMaxTangent = 57.289961630759;

/// Product of two polynomials in s, lowest power first.
std::vector<double> Multiply(const std::vector<double>& a, const std::vector<double>& b) {
  std::vector<double> product(a.size() + b.size() - 1, 0.0);
  for (std::size_t i = 0; i < a.size(); ++i) {
    for (std::size_t j = 0; j < b.size(); ++j) product[i + j] += a[i] * b[j];
  }
  return product;
}

/// s times the derivative by s.
std::vector<double> LogDerivative(std::vector<double> a) {
  for (std::size_t i = 0; i < a.size(); ++i) a[i] *= static_cast<double>(i);
  return a;
}

/// Undistorted radius up to which r N(s) / D(s) increases, s = r^2: where its derivative's
/// numerator N D + 2 s (N' D - N D') or its denominator D changes sign.
double MonotonicRadius(const std::array<double, 8>& k) {
  const std::vector<double> n = {1.0, k[0], k[1], k[4]};
  const std::vector<double> d = {1.0, k[5], k[6], k[7]};
  std::vector<double> slope = Multiply(n, d);
  const std::vector<double> n_by_s = Multiply(LogDerivative(n), d);
  const std::vector<double> d_by_s = Multiply(n, LogDerivative(d));
  for (std::size_t i = 0; i < slope.size(); ++i) slope[i] += 2.0 * (n_by_s[i] - d_by_s[i]);
  double s = kMaxTangent * kMaxTangent;
  const std::vector<double> folds = PositiveRoots(slope, s);
  if (!folds.empty()) s = folds.front();
  const std::vector<double> poles = PositiveRoots(d, s);
  // Well before a pole: the image is finite, so the radius there is far outside of it.
  if (!poles.empty()) s = poles.front() * (1.0 - 1e-6);
  return std::sqrt(s);
}

}  // namespace

PinholeCamera::PinholeCamera(const CameraIntrinsics& intrinsics)
    : CameraModel(intrinsics.width_px, intrinsics.height_px, intrinsics.principal_point_px),
      intrinsics_(intrinsics),
      focal_px_(intrinsics.focal_px[0], intrinsics.focal_px[1]) {
  std::copy(intrinsics.distortion.begin(), intrinsics.distortion.end(), k_.begin());
  max_radius_ = MonotonicRadius(k_);
  max_distorted_radius_ = DistortedRadius(max_radius_, nullptr);
  const auto radial = [this](double r, double* slope) { return DistortedRadius(r, slope); };
  double corner = 0.0;
  for (const Eigen::Vector2d& offset : Corners(intrinsics)) {
    corner = std::max(corner, (offset.array() / focal_px_).matrix().norm());
  }
  const double fit_radius =
      corner >= max_distorted_radius_
          ? max_radius_
          : InvertMonotonic(radial, corner, max_radius_, std::min(corner, max_radius_));
  approximate_inverse_ = ApproximateInverse(radial, fit_radius);
}

Result<CameraModelPtr> PinholeCamera::Create(const CameraIntrinsics& intrinsics) {
  const std::string& model = intrinsics.model;
  const std::size_t count = model == "plumb_bob" ? 5 : 8;
  SCENECALIB_RETURN_IF_ERROR(CheckFocal(intrinsics));
  SCENECALIB_RETURN_IF_ERROR(CheckCount(model, "distortion", intrinsics.distortion, count));
  SCENECALIB_RETURN_IF_ERROR(CheckCount(model, "polynomial_px", intrinsics.polynomial_px, 0));
  std::shared_ptr<PinholeCamera> camera(new PinholeCamera(intrinsics));
  // With tangential distortion the domain is not a disc: look at the whole image, corners included.
  constexpr int kSteps = 32;
  for (int i = 0; i <= kSteps; ++i) {
    for (int j = 0; j <= kSteps; ++j) {
      const Eigen::Vector2d pixel(-0.5 + intrinsics.width_px * i / static_cast<double>(kSteps),
                                  -0.5 + intrinsics.height_px * j / static_cast<double>(kSteps));
      const auto ray = camera->Unproject(pixel);
      if (!ray) {
        const double focal_px = camera->focal_px_.mean();
        return NotMonotonic(model, "distortion", std::atan(camera->max_radius_),
                            camera->max_distorted_radius_ * focal_px,
                            FarthestCorner(intrinsics).norm());
      }
      camera->max_theta_rad_ = std::max(camera->max_theta_rad_, Theta(*ray));
    }
  }
  return CameraModelPtr(camera);
}

double PinholeCamera::DistortedRadius(double r, double* derivative) const {
  const double s = r * r;
  const double n = 1.0 + s * (k_[0] + s * (k_[1] + s * k_[4]));
  const double d = 1.0 + s * (k_[5] + s * (k_[6] + s * k_[7]));
  if (derivative != nullptr) {
    const double n_by_s = k_[0] + s * (2.0 * k_[1] + s * 3.0 * k_[4]);
    const double d_by_s = k_[5] + s * (2.0 * k_[6] + s * 3.0 * k_[7]);
    *derivative = n / d + 2.0 * s * (n_by_s * d - n * d_by_s) / (d * d);
  }
  return r * n / d;
}

Eigen::Vector2d PinholeCamera::Distort(const Eigen::Vector2d& xy,
                                       Eigen::Matrix2d* distorted_by_xy) const {
  const double x = xy.x();
  const double y = xy.y();
  const double p1 = k_[2];
  const double p2 = k_[3];
  const double s = x * x + y * y;
  const double n = 1.0 + s * (k_[0] + s * (k_[1] + s * k_[4]));
  const double inverse_d = 1.0 / (1.0 + s * (k_[5] + s * (k_[6] + s * k_[7])));
  const double n_by_s = k_[0] + s * (2.0 * k_[1] + s * 3.0 * k_[4]);
  const double d_by_s = k_[5] + s * (2.0 * k_[6] + s * 3.0 * k_[7]);
  const double scale = n * inverse_d;
  const double scale_by_s = (n_by_s - scale * d_by_s) * inverse_d;
  const double mixed = 2.0 * (x * y * scale_by_s + p1 * x + p2 * y);
  *distorted_by_xy << scale + 2.0 * x * x * scale_by_s + 2.0 * p1 * y + 6.0 * p2 * x, mixed, mixed,
      scale + 2.0 * y * y * scale_by_s + 6.0 * p1 * y + 2.0 * p2 * x;
  return {scale * x + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
          scale * y + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y};
}

bool PinholeCamera::Undistort(const Eigen::Vector2d& distorted, Eigen::Vector2d* xy,
                              Eigen::Matrix2d* distorted_by_xy) const {
  constexpr int kMaxIterations = 30;
  constexpr double kLastStep = 1e-9;        // relative; Newton squares it
  constexpr double kRoundingFloor = 1e-13;  // a residual that no step can better
  const double radius = distorted.norm();
  if (!(radius <= 2.0 * max_distorted_radius_)) return false;  // tangential terms are corrections
  // The radial inverse is exact without tangential terms and a start close by with them.
  const auto radial = [this](double r, double* slope) { return DistortedRadius(r, slope); };
  const double r = InvertMonotonic(radial, std::min(radius, max_distorted_radius_), max_radius_,
                                   approximate_inverse_(radius));
  *xy = radius > 0.0 ? (r / radius * distorted).eval() : distorted;
  for (int i = 0; i < kMaxIterations; ++i) {
    const Eigen::Vector2d error = Distort(*xy, distorted_by_xy) - distorted;
    if (error.norm() <= kRoundingFloor * (1.0 + radius)) {
      return distorted_by_xy->determinant() > 0.0 && xy->norm() <= max_radius_;
    }
    const Eigen::Vector2d step = distorted_by_xy->inverse() * error;
    *xy -= step;
    if (!xy->allFinite()) return false;
    if (step.norm() <= kLastStep * (1.0 + r)) {
      Distort(*xy, distorted_by_xy);
      return distorted_by_xy->determinant() > 0.0 && xy->norm() <= max_radius_;
    }
  }
  return false;
}

std::optional<Eigen::Vector2d> PinholeCamera::ProjectTuned(const Eigen::Vector3d& point_in_camera,
                                                           const TunableIntrinsics& tunable,
                                                           ProjectionJacobians* jacobians) const {
  const double z = point_in_camera.z();
  if (!(z > 0.0 && tunable.focal_scale > 0.0)) return std::nullopt;
  const double inverse_z = 1.0 / z;
  const Eigen::Vector2d xy = inverse_z * point_in_camera.head<2>();
  if (!(xy.squaredNorm() <= max_radius_ * max_radius_)) return std::nullopt;
  Eigen::Matrix2d distorted_by_xy;
  const Eigen::Array2d distorted = Distort(xy, &distorted_by_xy).array();
  if (!(distorted_by_xy.determinant() > 0.0)) return std::nullopt;
  const Eigen::Array2d focal_px = tunable.focal_scale * focal_px_;
  if (jacobians != nullptr) {
    const Eigen::Matrix2d pixel_by_xy = focal_px.matrix().asDiagonal() * distorted_by_xy;
    jacobians->pixel_by_point << inverse_z * pixel_by_xy, -inverse_z * (pixel_by_xy * xy);
    jacobians->pixel_by_intrinsics << (focal_px_ * distorted).matrix(), Eigen::Matrix2d::Identity();
  }
  return (focal_px * distorted).matrix() + tunable.principal_point_px;
}

std::optional<Eigen::Vector3d> PinholeCamera::UnprojectTuned(
    const Eigen::Vector2d& pixel, const TunableIntrinsics& tunable,
    UnprojectionJacobians* jacobians) const {
  if (!(tunable.focal_scale > 0.0)) return std::nullopt;
  const Eigen::Array2d inverse_focal = 1.0 / (tunable.focal_scale * focal_px_);
  const Eigen::Vector2d distorted =
      ((pixel - tunable.principal_point_px).array() * inverse_focal).matrix();
  Eigen::Vector2d xy;
  Eigen::Matrix2d distorted_by_xy;
  if (!Undistort(distorted, &xy, &distorted_by_xy)) return std::nullopt;
  const double inverse_norm = 1.0 / std::sqrt(1.0 + xy.squaredNorm());
  const Eigen::Vector3d ray(inverse_norm * xy.x(), inverse_norm * xy.y(), inverse_norm);
  if (jacobians != nullptr) {
    Eigen::Matrix<double, 3, 2> ray_by_xy = -inverse_norm * ray * ray.head<2>().transpose();
    ray_by_xy.topRows<2>().diagonal().array() += inverse_norm;
    const Eigen::Matrix<double, 3, 2> ray_by_distorted = ray_by_xy * distorted_by_xy.inverse();
    jacobians->ray_by_pixel = ray_by_distorted * inverse_focal.matrix().asDiagonal();
    jacobians->ray_by_intrinsics << ray_by_distorted * (-distorted / tunable.focal_scale),
        -jacobians->ray_by_pixel;
  }
  return ray;
}

Result<CameraModelPtr> PinholeCamera::WithTunable(const TunableIntrinsics& tunable) const {
  CameraIntrinsics folded = intrinsics_;
  folded.principal_point_px = tunable.principal_point_px;
  for (double& focal_px : folded.focal_px) focal_px *= tunable.focal_scale;
  return CreateCameraModel(folded);
}

}  // namespace scenecalib
