#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <opencv2/core.hpp>
#include <optional>

namespace scenecalib {

/// Where the pixels around a reference pixel appear in another image, to second order: the pixel at
/// `offset` from the reference's centre is seen at
///   center_px + affine * offset + quadratic * (x^2, x y, y^2).
struct PatchWarp {
  Eigen::Vector2d center_px = Eigen::Vector2d::Zero();
  Eigen::Matrix2d affine = Eigen::Matrix2d::Identity();
  Eigen::Matrix<double, 2, 3> quadratic = Eigen::Matrix<double, 2, 3>::Zero();

  Eigen::Vector2d operator()(const Eigen::Vector2d& offset_px) const {
    const Eigen::Vector3d second(offset_px.x() * offset_px.x(), offset_px.x() * offset_px.y(),
                                 offset_px.y() * offset_px.y());
    return center_px + affine * offset_px + quadratic * second;
  }
};

/// What of the warp a registration adjusts, besides gain and bias of the grey values.
enum class WarpFreedom {
  kShift,   ///< center_px
  kAffine,  ///< center_px and affine
};

/// How grey values between pixels are read.
enum class PatchReading {
  kSmooth,    ///< through the cubic B-spline kernel, without bias towards the pixel grid
  kBilinear,  ///< several times faster: to follow a feature, not to measure it
};

struct PatchRegistrationLimits {
  int max_iterations = 12;
  double convergence_px = 0.004;
  double max_correction_px = 3.0;  ///< between the first and the last center_px
  double hopeless_ncc = -1.0;      ///< with less once nearly there it gives up
};

/// Outcome of a registration that converged inside the image.
struct PatchMatch {
  PatchWarp warp;
  double ncc = 0.0;              ///< normalised cross-correlation under the window, [-1, 1]
  double gain = 1.0;             ///< other = gain * reference + bias
  double bias = 0.0;             ///< grey values
  double residual_sigma = 0.0;   ///< grey values of the other image
  double reference_sigma = 0.0;  ///< of the reference's grey values under the window
  /// Covariance of center_px for residuals that are independent between pixels.
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Zero();
  int iterations = 0;
};

/// Correlation that two views of a patch can reach when both carry noise of this deviation, given
/// the deviation of the patch's grey values with the noise in them.
inline double ReachableNcc(double reference_sigma, double noise_sigma) {
  const double variance = reference_sigma * reference_sigma;
  return variance > 0.0 ? std::max(0.0, 1.0 - noise_sigma * noise_sigma / variance) : 0.0;
}

/// The neighbourhood of one pixel of a reference image, prepared for registering other images
/// against it.
///
/// Images are read through the cubic B-spline kernel without its prefilter: that smooths by 0.58 px
/// alike at every sub-pixel phase, so that neither noise nor interpolation pulls towards the pixel
/// grid (bilinear reading smooths most half-way between pixels and does).
///
/// The model is linear: under the right warp, with d the remaining displacement,
///   other(warp(o)) = gain * reference(o) + bias + gain * gradient(o) . d(o),
/// d(o) = d0 or d0 + D o, so that the normal matrix belongs to the reference alone and is
/// factorised once (inverse-compositional Gauss-Newton; Baker and Matthews, IJCV 2004). A Gaussian
/// window weighs the centre most.
///
/// A view from nearer shows detail that the reference cannot: where the warp stretches an axis of
/// the patch, a smooth reading averages two places of the other image, so that both are equally
/// blurred. Where it shrinks one the reference is the sharper: `blur_px` blurs it (ReferencePatch).
class PatchTemplate {
 public:
  /// `blur_px` is the standard deviation of a blur of the reference along its axes, smooth reading
  /// only. None when the window leaves the image or holds too little structure to be registered.
  static std::optional<PatchTemplate> Create(
      const cv::Mat& image, const Eigen::Vector2d& center_px, int radius_px, WarpFreedom freedom,
      PatchReading reading = PatchReading::kSmooth,
      const Eigen::Vector2d& blur_px = Eigen::Vector2d::Zero());

  /// Refines `initial` on another 8-bit grey image. None when the window leaves that image, the
  /// iteration does not converge within the limits or the warp degenerates.
  std::optional<PatchMatch> Register(const cv::Mat& image, const PatchWarp& initial,
                                     const PatchRegistrationLimits& limits) const;

  int radius_px() const { return radius_px_; }

 private:
  using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 8, 8>;
  using SmallVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 8, 1>;

  /// Weighted least squares on the patch's pixels, or on every other one of every other row.
  struct Normal {
    int stride = 1;
    Eigen::MatrixXf weighted;  ///< pixels x parameters, each row times its weight
    SmallMatrix inverse;       ///< of design^T W design; empty where that is singular
  };
  static Normal MakeNormal(const Eigen::MatrixXf& design, const Eigen::VectorXf& weights);

  bool Sample(const cv::Mat& image, const PatchWarp& warp, int stride,
              Eigen::VectorXf* values) const;
  double Correlation(const Eigen::VectorXf& values) const;
  /// The window's weights, one per pixel.
  const float* Weights() const { return fine_.weighted.col(num_parameters_ - 1).data(); }

  int radius_px_ = 0;
  PatchReading reading_ = PatchReading::kSmooth;
  int num_parameters_ = 0;  ///< 4 (shift) or 8 (affine), with gain and bias
  /// Pixels x parameters: displacement..., gain (the grey values less their weighted mean), bias.
  Eigen::MatrixXf design_;
  Normal fine_;                      ///< of all pixels
  Normal coarse_;                    ///< of a quarter of them, to come near
  Eigen::Matrix2d unit_covariance_;  ///< of d0 for residuals of unit variance
  double variance_ = 0.0;            ///< weighted variance of the reference
};

/// Views of one patch of a reference image, each blurred as another image needs it: where the warp
/// shrinks an axis of the patch, the reference shows detail that the other image cannot.
class ReferencePatch {
 public:
  /// As PatchTemplate::Create; the image's pixels are shared, not copied.
  static std::optional<ReferencePatch> Create(const cv::Mat& image,
                                              const Eigen::Vector2d& center_px, int radius_px,
                                              WarpFreedom freedom);

  /// As PatchTemplate::Register, from the view that suits `initial`. Not thread-safe: views are
  /// made when first needed.
  std::optional<PatchMatch> Register(const cv::Mat& image, const PatchWarp& initial,
                                     const PatchRegistrationLimits& limits);

 private:
  static constexpr int kNumBlurs = 4;

  cv::Mat image_;
  Eigen::Vector2d center_px_ = Eigen::Vector2d::Zero();
  int radius_px_ = 0;
  WarpFreedom freedom_ = WarpFreedom::kShift;
  /// By the blur of the first and the second axis. The sharp one is always there.
  std::optional<PatchTemplate> views_[kNumBlurs][kNumBlurs];
  bool is_tried_[kNumBlurs][kNumBlurs] = {};
};

}  // namespace scenecalib
