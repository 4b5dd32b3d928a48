#include "scenecalib/tracking/patch_registration.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "patch_sampling.h"
#include "patch_sums.h"
#include "pixel_grid.h"
#include "pixel_kernels.h"

namespace scenecalib {
namespace {

/// Deviation of an image's own blur as it is read smoothly: the pixel's area and the kernel.
constexpr double kReadingSigmaPx = 0.65;
/// Stretches of an axis below this need no blur.
constexpr double kMinStretch = 1.15;

/// How far to either side of a pixel the other image is read where the warp stretches an axis of
/// the patch, in pixels of the reference; 0: read once. Two readings have that deviation.
double ReadingOffsetPx(double stretch) {
  if (stretch < kMinStretch) return 0.0;
  return kReadingSigmaPx * std::sqrt(1.0 - 1.0 / (stretch * stretch));
}

/// Iterations with all pixels after which a registration that leads nowhere is given up.
constexpr int kHopelessIteration = 1;

/// Smallest pivot of the normal equations of unit weights in all.
constexpr double kMinPivot = 1e-4;

/// Only every second pixel of every second row takes part until a step is smaller than this; a
/// small patch has too few of them.
constexpr double kCoarseStepPx = 0.1;
constexpr int kCoarseStride = 2;
constexpr int kMinCoarseRadiusPx = 9;

/// Shrinkage of an axis from one of ReferencePatch's blurs to the next.
constexpr double kBlurRatio = 1.35;

int BlurIndex(double stretch, int num_blurs) {
  if (stretch > 1.0 / kMinStretch) return 0;
  return std::clamp(static_cast<int>(std::lround(-std::log(stretch) / std::log(kBlurRatio))), 1,
                    num_blurs - 1);
}

/// Deviation of the blur that makes the reference as blurred as a view that shrinks it.
double BlurPx(int index) {
  return kReadingSigmaPx * std::sqrt(std::pow(kBlurRatio, 2 * index) - 1.0);
}

/// Weights of a patch's pixels, row by row, padded: less towards its rim, one in sum.
const Eigen::VectorXf& WindowOf(int radius_px) {
  thread_local std::map<int, Eigen::VectorXf> windows;  // there are few sizes
  Eigen::VectorXf& window = windows[radius_px];
  if (window.size() > 0) return window;
  const int edge = 2 * radius_px + 1;
  Eigen::VectorXf profile(edge);
  for (int x = -radius_px; x <= radius_px; ++x) {
    const float u = static_cast<float>(x) * (1.0F / static_cast<float>(radius_px));
    profile[x + radius_px] = std::exp(-1.2F * u * u);
  }
  window = Eigen::VectorXf::Zero(PaddedCount(edge * edge));
  for (int y = 0; y < edge; ++y) window.segment(y * edge, edge) = profile[y] * profile;
  window /= window.sum();
  return window;
}

/// Of pixels x columns, padded: only what lies behind the last pixel is filled.
Eigen::MatrixXf PaddedMatrix(Eigen::Index num_pixels, Eigen::Index num_columns) {
  Eigen::MatrixXf padded(PaddedCount(num_pixels), num_columns);
  padded.bottomRows(padded.rows() - num_pixels).setZero();
  return padded;
}

/// The rows of the pixels that take part in coarse steps.
Eigen::MatrixXf Thinned(const Eigen::MatrixXf& by_pixel, int edge) {
  const int coarse_edge = (edge + kCoarseStride - 1) / kCoarseStride;
  Eigen::MatrixXf thinned = PaddedMatrix(coarse_edge * coarse_edge, by_pixel.cols());
  for (Eigen::Index column = 0; column < by_pixel.cols(); ++column) {
    float* out = thinned.col(column).data();
    for (int y = 0; y < edge; y += kCoarseStride) {
      for (int x = 0; x < edge; x += kCoarseStride) *out++ = by_pixel(y * edge + x, column);
    }
  }
  return thinned;
}

}  // namespace

std::optional<PatchTemplate> PatchTemplate::Create(const cv::Mat& image,
                                                   const Eigen::Vector2d& center_px, int radius_px,
                                                   WarpFreedom freedom, PatchReading reading,
                                                   const Eigen::Vector2d& blur_px) {
  const int margin =
      reading == PatchReading::kSmooth ? static_cast<int>(std::ceil(2.5 * blur_px.maxCoeff())) : 0;
  const double r = radius_px + margin;
  if (!CanRead(image, center_px.x() - r, center_px.y() - r) ||
      !CanRead(image, center_px.x() + r, center_px.y() + r)) {
    return std::nullopt;
  }
  PatchTemplate patch;
  patch.radius_px_ = radius_px;
  patch.reading_ = reading;
  const int edge = 2 * radius_px + 1;
  const int num_pixels = edge * edge;
  const int num_motion = freedom == WarpFreedom::kShift ? 2 : 6;
  const int n = num_motion + 2;
  patch.num_parameters_ = n;
  patch.design_ = PaddedMatrix(num_pixels, n);
  const Eigen::VectorXf& weights = WindowOf(radius_px);

  // The offsets of the affine columns are scaled by the radius so that the normal matrix is well
  // conditioned in single precision; Register undoes it.
  const float inverse_radius = 1.0F / static_cast<float>(radius_px);
  PixelGrid grid = reading == PatchReading::kSmooth
                       ? ReadGridSmoothed(image, center_px, radius_px + margin)
                       : ReadGridBilinear(image, center_px, radius_px);
  if (margin > 0) Blur(blur_px, margin, &grid);
  const auto design_column = [&](int column) { return patch.design_.col(column).data(); };
  std::copy_n(grid.value.data(), num_pixels, design_column(num_motion));
  std::copy_n(grid.gradient_x.data(), num_pixels, design_column(0));
  std::copy_n(grid.gradient_y.data(), num_pixels, design_column(1));
  std::fill_n(design_column(num_motion + 1), num_pixels, 1.0F);
  const Eigen::VectorXf offset =
      inverse_radius * Eigen::VectorXf::LinSpaced(edge, static_cast<float>(-radius_px),
                                                  static_cast<float>(radius_px));
  for (int y = 0; y < edge && freedom == WarpFreedom::kAffine; ++y) {
    const int first = y * edge;
    for (int axis = 0; axis < 2; ++axis) {
      const auto gradient = patch.design_.col(axis).segment(first, edge);
      patch.design_.col(2 + 2 * axis).segment(first, edge) = gradient.cwiseProduct(offset);
      patch.design_.col(3 + 2 * axis).segment(first, edge) = gradient * offset[y];
    }
  }
  patch.design_.col(num_motion).head(num_pixels).array() -=
      weights.dot(patch.design_.col(num_motion));
  patch.variance_ = weights.dot(patch.design_.col(num_motion).cwiseAbs2());
  // A patch without structure in some direction has no inverse.
  patch.fine_ = MakeNormal(patch.design_, weights);
  if (!(patch.variance_ > 1e-3) || patch.fine_.inverse.size() == 0) return std::nullopt;
  if (radius_px >= kMinCoarseRadiusPx) {
    patch.coarse_ = MakeNormal(Thinned(patch.design_, edge), Thinned(weights, edge));
    patch.coarse_.stride = kCoarseStride;
  }
  // Weighted least squares with a window that is not the inverse noise: the sandwich.
  patch.unit_covariance_ =
      SandwichOf(patch.fine_.weighted, patch.fine_.inverse.leftCols<2>().cast<float>());
  return patch;
}

PatchTemplate::Normal PatchTemplate::MakeNormal(const Eigen::MatrixXf& design,
                                                const Eigen::VectorXf& weights) {
  const Eigen::Index n = design.cols();
  Normal normal;
  normal.weighted = Weighted(design, weights);
  const Eigen::LDLT<SmallMatrix> factor(NormalOf(design, normal.weighted));
  const double min_pivot = factor.vectorD().minCoeff();
  if (factor.info() == Eigen::Success && min_pivot > kMinPivot * weights.sum()) {
    normal.inverse = factor.solve(SmallMatrix::Identity(n, n));
  }
  return normal;
}

bool PatchTemplate::Sample(const cv::Mat& image, const PatchWarp& warp, int stride,
                           Eigen::VectorXf* values) const {
  const bool is_smooth = reading_ == PatchReading::kSmooth;
  const Eigen::Vector2d across =
      warp.affine.col(0) * (is_smooth ? ReadingOffsetPx(warp.affine.col(0).norm()) : 0.0);
  const Eigen::Vector2d down =
      warp.affine.col(1) * (is_smooth ? ReadingOffsetPx(warp.affine.col(1).norm()) : 0.0);
  // A second-order warp of a small window is nearly affine: when its border is inside, so is all of
  // it; the border is checked only through its corners and edge middles.
  const double r = radius_px_;
  const Eigen::Vector2d margin = Eigen::Vector2d::Ones() + across.cwiseAbs() + down.cwiseAbs();
  for (double y = -r; y <= r; y += r) {
    for (double x = -r; x <= r; x += r) {
      const Eigen::Vector2d pixel = warp({x, y});
      if (!CanRead(image, pixel.x() - margin.x(), pixel.y() - margin.y()) ||
          !CanRead(image, pixel.x() + margin.x(), pixel.y() + margin.y())) {
        return false;
      }
    }
  }
  const Eigen::Index num_pixels = stride == 1 ? fine_.weighted.rows() : coarse_.weighted.rows();
  if (values->size() != num_pixels) values->setZero(num_pixels);
  const PatchSampler sample = FastestSampler(reading_);
  const int num_across = across.isZero() ? 1 : 2;
  const int num_down = down.isZero() ? 1 : 2;
  if (num_across * num_down == 1) {
    sample(image, {warp, radius_px_, stride}, values->data());
    return true;
  }
  Eigen::VectorXf once = Eigen::VectorXf::Zero(num_pixels);
  values->setZero();
  for (int i = 0; i < num_across; ++i) {
    for (int j = 0; j < num_down; ++j) {
      PatchWarp shifted = warp;
      shifted.center_px += (i == 0 ? across : -across) + (j == 0 ? down : -down);
      sample(image, {shifted, radius_px_, stride}, once.data());
      *values += once;
    }
  }
  *values /= static_cast<float>(num_across * num_down);
  return true;
}

/// -1 where the values are all alike.
double PatchTemplate::Correlation(const Eigen::VectorXf& values) const {
  const WeightedMoments moments =
      MomentsOf(values, Weights(), fine_.weighted.col(num_parameters_ - 2).data());
  const double variance = moments.variance;
  if (!(variance > 1e-6)) return -1.0;
  return moments.product / std::sqrt(variance * variance_);
}

std::optional<PatchMatch> PatchTemplate::Register(const cv::Mat& image, const PatchWarp& initial,
                                                  const PatchRegistrationLimits& limits) const {
  PatchMatch match;
  match.warp = initial;
  const int num_motion = num_parameters_ - 2;
  Eigen::VectorXf values;
  SmallVector products(num_parameters_);
  SmallVector solution(num_parameters_);
  bool converged = false;
  int num_fine = 0;
  const Normal* normal = coarse_.inverse.size() > 0 ? &coarse_ : &fine_;
  for (; match.iterations < limits.max_iterations && !converged; ++match.iterations) {
    if (!Sample(image, match.warp, normal->stride, &values)) return std::nullopt;
    SumProducts(normal->weighted, values.data(), products.data());
    solution.noalias() = normal->inverse * products;
    match.gain = solution[num_motion];
    const bool is_fine = normal == &fine_;
    if (is_fine && num_fine++ == kHopelessIteration && Correlation(values) < limits.hopeless_ncc) {
      return std::nullopt;
    }
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
    const auto is_within = [&](double limit_px) {
      return step.norm() < limit_px && corner_step_px < 10 * limit_px;
    };
    if (is_fine) {
      converged = is_within(limits.convergence_px);
    } else if (is_within(kCoarseStepPx)) {
      normal = &fine_;
    }
  }
  if (!converged) return std::nullopt;

  const Eigen::Matrix<float, Eigen::Dynamic, 1, 0, 8, 1> model = solution.cast<float>();
  const double residual_variance = ResidualSquare(values, design_, model.data(), Weights());
  match.ncc = Correlation(values);
  if (match.ncc <= -1.0) return std::nullopt;
  match.reference_sigma = std::sqrt(variance_);
  match.bias = solution[num_motion + 1];
  match.residual_sigma = std::sqrt(residual_variance);
  match.covariance_px2 = match.warp.affine * unit_covariance_ * match.warp.affine.transpose() *
                         (residual_variance / (match.gain * match.gain));
  return match;
}

std::optional<ReferencePatch> ReferencePatch::Create(const cv::Mat& image,
                                                     const Eigen::Vector2d& center_px,
                                                     int radius_px, WarpFreedom freedom) {
  ReferencePatch patch;
  patch.image_ = image;
  patch.center_px_ = center_px;
  patch.radius_px_ = radius_px;
  patch.freedom_ = freedom;
  patch.views_[0][0] = PatchTemplate::Create(image, center_px, radius_px, freedom);
  patch.is_tried_[0][0] = true;
  if (!patch.views_[0][0]) return std::nullopt;
  return patch;
}

std::optional<PatchMatch> ReferencePatch::Register(const cv::Mat& image, const PatchWarp& initial,
                                                   const PatchRegistrationLimits& limits) {
  const int i = BlurIndex(initial.affine.col(0).norm(), kNumBlurs);
  const int j = BlurIndex(initial.affine.col(1).norm(), kNumBlurs);
  std::optional<PatchTemplate>& view = views_[i][j];
  if (!is_tried_[i][j]) {
    is_tried_[i][j] = true;
    view = PatchTemplate::Create(image_, center_px_, radius_px_, freedom_, PatchReading::kSmooth,
                                 {BlurPx(i), BlurPx(j)});
  }
  // A blurred view needs a margin around the patch, which may not be there.
  return (view ? view : views_[0][0])->Register(image, initial, limits);
}

}  // namespace scenecalib
