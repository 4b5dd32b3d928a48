#include "scenecalib/tracking/patch_registration.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <opencv2/core/hal/intrin.hpp>

namespace scenecalib {
namespace {

using cv::v_float32x4;

/// Weights of the cubic B-spline for the four pixels around a position with fraction t: four
/// polynomials of t at once.
inline v_float32x4 SplineWeights(float t) {
  const v_float32x4 v = cv::v_setall_f32(t);
  v_float32x4 weights(-1.0F / 6.0F, 0.5F, -0.5F, 1.0F / 6.0F);
  weights = cv::v_muladd(weights, v, v_float32x4(0.5F, -1.0F, 0.5F, 0.0F));
  weights = cv::v_muladd(weights, v, v_float32x4(-0.5F, 0.0F, 0.5F, 0.0F));
  return cv::v_muladd(weights, v, v_float32x4(1.0F / 6.0F, 2.0F / 3.0F, 1.0F / 6.0F, 0.0F));
}

/// Their derivatives by t.
inline v_float32x4 SplineDerivatives(float t) {
  const v_float32x4 v = cv::v_setall_f32(t);
  v_float32x4 weights(-0.5F, 1.5F, -1.5F, 0.5F);
  weights = cv::v_muladd(weights, v, v_float32x4(1.0F, -2.0F, 1.0F, 0.0F));
  return cv::v_muladd(weights, v, v_float32x4(-0.5F, 0.0F, 0.5F, 0.0F));
}

inline v_float32x4 LoadRow(const uchar* row) {
  return cv::v_cvt_f32(cv::v_reinterpret_as_s32(cv::v_load_expand_q(row)));
}

/// Sum over the 4x4 pixels that begin at `corner`, with separable weights.
inline float Convolve(const uchar* corner, std::size_t step, const v_float32x4& weights_x,
                      const v_float32x4& weights_y) {
  float y[4];
  cv::v_store(y, weights_y);
  v_float32x4 sum = LoadRow(corner) * cv::v_setall_f32(y[0]);
  sum = cv::v_muladd(LoadRow(corner + step), cv::v_setall_f32(y[1]), sum);
  sum = cv::v_muladd(LoadRow(corner + 2 * step), cv::v_setall_f32(y[2]), sum);
  sum = cv::v_muladd(LoadRow(corner + 3 * step), cv::v_setall_f32(y[3]), sum);
  return cv::v_reduce_sum(sum * weights_x);
}

struct Cell {
  const uchar* corner;
  float fraction_x;
  float fraction_y;
};

inline Cell Locate(const cv::Mat& image, float x, float y) {
  const int column = static_cast<int>(x);  // positions are positive: truncation is floor
  const int row = static_cast<int>(y);
  return {image.data + (row - 1) * image.step[0] + (column - 1), x - static_cast<float>(column),
          y - static_cast<float>(row)};
}

inline bool CanRead(const cv::Mat& image, double x, double y) {
  return x >= 1.0 && y >= 1.0 && x < image.cols - 3.0 && y < image.rows - 2.0;
}

}  // namespace

SmoothedPixel ReadSmoothed(const cv::Mat& image, double x_px, double y_px) {
  const Cell cell = Locate(image, static_cast<float>(x_px), static_cast<float>(y_px));
  const v_float32x4 wx = SplineWeights(cell.fraction_x);
  const v_float32x4 wy = SplineWeights(cell.fraction_y);
  const v_float32x4 dx = SplineDerivatives(cell.fraction_x);
  const v_float32x4 dy = SplineDerivatives(cell.fraction_y);
  const std::size_t step = image.step[0];
  return {Convolve(cell.corner, step, wx, wy), Convolve(cell.corner, step, dx, wy),
          Convolve(cell.corner, step, wx, dy)};
}

std::optional<PatchTemplate> PatchTemplate::Create(const cv::Mat& image,
                                                   const Eigen::Vector2d& center_px, int radius_px,
                                                   WarpFreedom freedom) {
  const double r = radius_px;
  if (!CanRead(image, center_px.x() - r, center_px.y() - r) ||
      !CanRead(image, center_px.x() + r, center_px.y() + r)) {
    return std::nullopt;
  }
  PatchTemplate patch;
  patch.radius_px_ = radius_px;
  const int edge = 2 * radius_px + 1;
  const int num_pixels = edge * edge;
  const int num_motion = freedom == WarpFreedom::kShift ? 2 : 6;
  const int n = num_motion + 2;
  patch.num_parameters_ = n;
  patch.reference_.resize(num_pixels);
  patch.design_.resize(num_pixels, n);
  Eigen::VectorXf weights(num_pixels);

  // The offsets of the affine columns are scaled by the radius so that the normal matrix is well
  // conditioned in single precision; Register undoes it.
  const float inverse_radius = 1.0F / static_cast<float>(radius_px);
  Eigen::VectorXf profile(edge);  // the window is separable
  for (int x = -radius_px; x <= radius_px; ++x) {
    const float u = static_cast<float>(x) * inverse_radius;
    profile[x + radius_px] = std::exp(-1.2F * u * u);
  }
  int i = 0;
  for (int y = -radius_px; y <= radius_px; ++y) {
    for (int x = -radius_px; x <= radius_px; ++x, ++i) {
      const SmoothedPixel pixel = ReadSmoothed(image, center_px.x() + x, center_px.y() + y);
      const float u = static_cast<float>(x) * inverse_radius;
      const float v = static_cast<float>(y) * inverse_radius;
      weights[i] = profile[x + radius_px] * profile[y + radius_px];
      patch.reference_[i] = pixel.value;
      patch.design_(i, 0) = pixel.gradient_x;
      patch.design_(i, 1) = pixel.gradient_y;
      if (freedom == WarpFreedom::kAffine) {
        patch.design_(i, 2) = pixel.gradient_x * u;
        patch.design_(i, 3) = pixel.gradient_x * v;
        patch.design_(i, 4) = pixel.gradient_y * u;
        patch.design_(i, 5) = pixel.gradient_y * v;
      }
    }
  }
  weights /= weights.sum();
  patch.reference_.array() -= weights.dot(patch.reference_);
  patch.variance_ = weights.dot(patch.reference_.cwiseAbs2());
  patch.design_.col(num_motion) = patch.reference_;
  patch.design_.col(num_motion + 1).setOnes();
  patch.weighted_ = weights.asDiagonal() * patch.design_;

  const Eigen::MatrixXd normal =
      (patch.design_.transpose() * patch.weighted_).template cast<double>();
  const Eigen::LDLT<Eigen::MatrixXd> factor(normal);
  // A patch without structure in some direction: the smallest pivot vanishes against the largest.
  const double min_pivot = factor.vectorD().minCoeff();
  if (factor.info() != Eigen::Success || !(patch.variance_ > 1e-3) || !(min_pivot > 1e-4)) {
    return std::nullopt;
  }
  patch.inverse_ = factor.solve(Eigen::MatrixXd::Identity(n, n));
  // Weighted least squares with a window that is not the inverse noise: the sandwich.
  const Eigen::MatrixXd meat =
      (patch.weighted_.transpose() * patch.weighted_).template cast<double>();
  patch.unit_covariance_ = (patch.inverse_ * meat * patch.inverse_).topLeftCorner<2, 2>();
  return patch;
}

bool PatchTemplate::Sample(const cv::Mat& image, const PatchWarp& warp,
                           Eigen::VectorXf* values) const {
  // A second-order warp of a small window is nearly affine: when its border is inside, so is all of
  // it; the border is checked pixel by pixel below only through the corners and edge middles.
  const double r = radius_px_;
  for (double y = -r; y <= r; y += r) {
    for (double x = -r; x <= r; x += r) {
      const Eigen::Vector2d pixel = warp({x, y});
      if (!CanRead(image, pixel.x() - 1.0, pixel.y() - 1.0) ||
          !CanRead(image, pixel.x() + 1.0, pixel.y() + 1.0)) {
        return false;
      }
    }
  }
  values->resize(reference_.size());
  const std::size_t step = image.step[0];
  const Eigen::Matrix2f a = warp.affine.cast<float>();
  const Eigen::Matrix<float, 2, 3> q = warp.quadratic.cast<float>();
  const Eigen::Vector2f c = warp.center_px.cast<float>();
  float* value = values->data();
  for (int y = -radius_px_; y <= radius_px_; ++y) {
    const auto fy = static_cast<float>(y);
    const float row_x = c.x() + (a(0, 1) + q(0, 2) * fy) * fy;
    const float row_y = c.y() + (a(1, 1) + q(1, 2) * fy) * fy;
    const float slope_x = a(0, 0) + q(0, 1) * fy;
    const float slope_y = a(1, 0) + q(1, 1) * fy;
    for (int x = -radius_px_; x <= radius_px_; ++x) {
      const auto fx = static_cast<float>(x);
      const Cell cell = Locate(image, row_x + (slope_x + q(0, 0) * fx) * fx,
                               row_y + (slope_y + q(1, 0) * fx) * fx);
      *value++ = Convolve(cell.corner, step, SplineWeights(cell.fraction_x),
                          SplineWeights(cell.fraction_y));
    }
  }
  return true;
}

std::optional<PatchMatch> PatchTemplate::Register(const cv::Mat& image, const PatchWarp& initial,
                                                  const PatchRegistrationLimits& limits) const {
  PatchMatch match;
  match.warp = initial;
  const int num_motion = num_parameters_ - 2;
  Eigen::VectorXf values;
  Eigen::VectorXd solution(num_parameters_);
  bool converged = false;
  for (; match.iterations < limits.max_iterations && !converged; ++match.iterations) {
    if (!Sample(image, match.warp, &values)) return std::nullopt;
    solution = inverse_ * (weighted_.transpose() * values).cast<double>();
    match.gain = solution[num_motion];
    if (!(match.gain > 0.05 && match.gain < 20.0)) return std::nullopt;
    // other(warp(o)) looks like reference(o + d0 + D o): compose the warp with the inverse of that.
    const Eigen::Vector2d shift = solution.head<2>() / match.gain;
    Eigen::Matrix2d growth = Eigen::Matrix2d::Identity();
    if (num_motion == 6) {
      growth(0, 0) += solution[2] / (match.gain * radius_px_);
      growth(0, 1) += solution[3] / (match.gain * radius_px_);
      growth(1, 0) += solution[4] / (match.gain * radius_px_);
      growth(1, 1) += solution[5] / (match.gain * radius_px_);
      if (!(growth.determinant() > 0.2 && growth.determinant() < 5.0)) return std::nullopt;
      match.warp.affine = match.warp.affine * growth.inverse();
    }
    const Eigen::Vector2d step = match.warp.affine * shift;
    match.warp.center_px -= step;
    if (!((match.warp.center_px - initial.center_px).norm() < limits.max_correction_px)) {
      return std::nullopt;
    }
    const double corner_step_px = (growth - Eigen::Matrix2d::Identity()).norm() * 0.5 * radius_px_;
    converged = step.norm() < limits.convergence_px && corner_step_px < 10 * limits.convergence_px;
  }
  if (!converged) return std::nullopt;

  const Eigen::VectorXf residual = values - design_ * solution.cast<float>();
  const auto weights = weighted_.col(num_parameters_ - 1);
  const double residual_variance = weights.dot(residual.cwiseAbs2());
  const double mean = weights.dot(values);
  const double variance =
      weights.dot((values.array() - static_cast<float>(mean)).matrix().cwiseAbs2());
  if (!(variance > 1e-6)) return std::nullopt;
  const double covariance = weighted_.col(num_motion).dot(values);
  match.ncc = covariance / std::sqrt(variance * variance_);
  match.bias = solution[num_motion + 1];
  match.residual_sigma = std::sqrt(residual_variance);
  match.covariance_px2 = match.warp.affine * unit_covariance_ * match.warp.affine.transpose() *
                         (residual_variance / (match.gain * match.gain));
  return match;
}

}  // namespace scenecalib
