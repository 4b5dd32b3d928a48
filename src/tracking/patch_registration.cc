#include "scenecalib/tracking/patch_registration.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <opencv2/core/hal/intrin.hpp>

namespace scenecalib {
namespace {

using cv::v_float32x4;

/// Weights of the cubic B-spline for the four pixels around a position with fraction t.
void SplineWeights(float t, float* weights) {
  const float u = 1.0F - t;
  weights[0] = u * u * u / 6.0F;
  weights[1] = 2.0F / 3.0F - t * t + 0.5F * t * t * t;
  weights[2] = 2.0F / 3.0F - u * u + 0.5F * u * u * u;
  weights[3] = t * t * t / 6.0F;
}

/// Their derivatives by t.
void SplineDerivatives(float t, float* weights) {
  const float u = 1.0F - t;
  weights[0] = -0.5F * u * u;
  weights[1] = -2.0F * t + 1.5F * t * t;
  weights[2] = 2.0F * u - 1.5F * u * u;
  weights[3] = 0.5F * t * t;
}

/// The weights in steps of 1/512 px: rounding to them is random from pixel to pixel of a patch.
class SplineTable {
 public:
  /// Weights as they are, and as two pairs of 16-bit integers that sum up to kOne.
  struct Entry {
    float weights[4];
    std::uint32_t pairs[2];
  };
  static constexpr int kOne = 1 << 14;

  SplineTable() {
    for (int i = 0; i <= kSteps; ++i) {
      Entry& entry = entries_[i];
      SplineWeights(static_cast<float>(i) / kSteps, entry.weights);
      std::uint32_t whole[4];
      for (int k : {0, 2, 3}) {
        whole[k] = static_cast<std::uint32_t>(std::lround(entry.weights[k] * kOne));
      }
      whole[1] = kOne - whole[0] - whole[2] - whole[3];
      entry.pairs[0] = whole[0] | (whole[1] << 16);
      entry.pairs[1] = whole[2] | (whole[3] << 16);
    }
  }

  const Entry& At(float fraction) const {
    return entries_[static_cast<int>(fraction * kSteps + 0.5F)];
  }

 private:
  static constexpr int kSteps = 512;
  Entry entries_[kSteps + 1];
};

const SplineTable kSpline;

inline v_float32x4 LoadRow(const uchar* row) {
  return cv::v_cvt_f32(cv::v_reinterpret_as_s32(cv::v_load_expand_q(row)));
}

/// Sum over the 4x4 pixels that begin at `corner`, with separable weights.
inline float Convolve(const uchar* corner, std::size_t step, const float* weights_x,
                      const float* weights_y) {
  v_float32x4 sum = LoadRow(corner) * cv::v_setall_f32(weights_y[0]);
  sum = cv::v_muladd(LoadRow(corner + step), cv::v_setall_f32(weights_y[1]), sum);
  sum = cv::v_muladd(LoadRow(corner + 2 * step), cv::v_setall_f32(weights_y[2]), sum);
  sum = cv::v_muladd(LoadRow(corner + 3 * step), cv::v_setall_f32(weights_y[3]), sum);
  return cv::v_reduce_sum(sum * cv::v_load(weights_x));
}

inline std::uint32_t FourPixels(const uchar* row) {
  std::uint32_t pixels;
  std::memcpy(&pixels, row, sizeof(pixels));
  return pixels;
}

/// The columns of the 4x4 pixels that begin at `corner`, summed with `down` and weighed with
/// `across`: what Convolve sums up, times kOne.
inline v_float32x4 WeighColumns(const uchar* corner, std::size_t step,
                                const SplineTable::Entry& across, const SplineTable::Entry& down) {
  const cv::v_uint32x4 even(FourPixels(corner), FourPixels(corner + 2 * step), 0, 0);
  const cv::v_uint32x4 odd(FourPixels(corner + step), FourPixels(corner + 3 * step), 0, 0);
  cv::v_uint8x16 rows, unused;  // two rows interleaved, then the other two
  cv::v_zip(cv::v_reinterpret_as_u8(even), cv::v_reinterpret_as_u8(odd), rows, unused);
  cv::v_uint16x8 upper, lower;
  cv::v_expand(rows, upper, lower);
  const cv::v_int32x4 sum =
      cv::v_dotprod(cv::v_reinterpret_as_s16(upper),
                    cv::v_reinterpret_as_s16(cv::v_setall_u32(down.pairs[0]))) +
      cv::v_dotprod(cv::v_reinterpret_as_s16(lower),
                    cv::v_reinterpret_as_s16(cv::v_setall_u32(down.pairs[1])));
  return cv::v_cvt_f32(sum) * cv::v_load(across.weights);
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

/// Between the middle four of the cell's pixels.
inline float Bilinear(const Cell& cell, std::size_t step) {
  const uchar* above = cell.corner + step + 1;
  const uchar* below = above + step;
  const float top = above[0] + cell.fraction_x * static_cast<float>(above[1] - above[0]);
  const float bottom = below[0] + cell.fraction_x * static_cast<float>(below[1] - below[0]);
  return top + cell.fraction_y * (bottom - top);
}

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

/// Iterations after which a registration that leads nowhere is given up.
constexpr int kHopelessIteration = 3;

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

/// Weights of a Gaussian at whole pixels from -margin to margin.
Eigen::VectorXf GaussianWeights(double sigma_px, int margin) {
  Eigen::VectorXf weights = Eigen::VectorXf::Zero(2 * margin + 1);
  for (int i = -margin; i <= margin; ++i) {
    const double u = sigma_px > 0.0 ? i / sigma_px : (i == 0 ? 0.0 : 1e3);
    weights[i + margin] = static_cast<float>(std::exp(-0.5 * u * u));
  }
  return weights / weights.sum();
}

/// Values and gradients of a square of pixels around a centre.
struct PixelGrid {
  Eigen::MatrixXf value, gradient_x, gradient_y;  ///< rows are y
};

PixelGrid ReadGridSmoothed(const cv::Mat& image, const Eigen::Vector2d& center_px, int radius_px) {
  const int edge = 2 * radius_px + 1;
  PixelGrid grid{Eigen::MatrixXf(edge, edge), Eigen::MatrixXf(edge, edge),
                 Eigen::MatrixXf(edge, edge)};
  for (int column = 0; column < edge; ++column) {
    for (int row = 0; row < edge; ++row) {
      const SmoothedPixel pixel =
          ReadSmoothed(image, center_px.x() + column - radius_px, center_px.y() + row - radius_px);
      grid.value(row, column) = pixel.value;
      grid.gradient_x(row, column) = pixel.gradient_x;
      grid.gradient_y(row, column) = pixel.gradient_y;
    }
  }
  return grid;
}

/// Bilinear; gradients over two pixels.
PixelGrid ReadGridBilinear(const cv::Mat& image, const Eigen::Vector2d& center_px, int radius_px) {
  const int edge = 2 * radius_px + 3;
  const auto left = static_cast<float>(center_px.x() - radius_px - 1);
  const auto top = static_cast<float>(center_px.y() - radius_px - 1);
  Eigen::MatrixXf value(edge, edge);
  for (int column = 0; column < edge; ++column) {
    for (int row = 0; row < edge; ++row) {
      value(row, column) =
          Bilinear(Locate(image, left + static_cast<float>(column), top + static_cast<float>(row)),
                   image.step[0]);
    }
  }
  const int inner = edge - 2;
  return {value.block(1, 1, inner, inner),
          0.5F * (value.block(1, 2, inner, inner) - value.block(1, 0, inner, inner)),
          0.5F * (value.block(2, 1, inner, inner) - value.block(0, 1, inner, inner))};
}

/// The grid without its margin, blurred.
void Blur(const Eigen::Vector2d& sigma_px, int margin, PixelGrid* grid) {
  const Eigen::VectorXf across = GaussianWeights(sigma_px.x(), margin);
  const Eigen::VectorXf down = GaussianWeights(sigma_px.y(), margin);
  for (Eigen::MatrixXf* channel : {&grid->value, &grid->gradient_x, &grid->gradient_y}) {
    const Eigen::Index inner = channel->rows() - 2 * margin;
    Eigen::MatrixXf rows = Eigen::MatrixXf::Zero(inner, channel->cols());
    for (int i = 0; i <= 2 * margin; ++i) rows += down[i] * channel->middleRows(i, inner);
    Eigen::MatrixXf blurred = Eigen::MatrixXf::Zero(inner, inner);
    for (int i = 0; i <= 2 * margin; ++i) blurred += across[i] * rows.middleCols(i, inner);
    *channel = std::move(blurred);
  }
}

}  // namespace

SmoothedPixel ReadSmoothed(const cv::Mat& image, double x_px, double y_px) {
  const Cell cell = Locate(image, static_cast<float>(x_px), static_cast<float>(y_px));
  float wx[4], wy[4], dx[4], dy[4];
  SplineWeights(cell.fraction_x, wx);
  SplineWeights(cell.fraction_y, wy);
  SplineDerivatives(cell.fraction_x, dx);
  SplineDerivatives(cell.fraction_y, dy);
  const std::size_t step = image.step[0];
  return {Convolve(cell.corner, step, wx, wy), Convolve(cell.corner, step, dx, wy),
          Convolve(cell.corner, step, wx, dy)};
}

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
  PixelGrid grid = reading == PatchReading::kSmooth
                       ? ReadGridSmoothed(image, center_px, radius_px + margin)
                       : ReadGridBilinear(image, center_px, radius_px);
  if (margin > 0) Blur(blur_px, margin, &grid);
  int i = 0;
  for (int y = -radius_px; y <= radius_px; ++y) {
    for (int x = -radius_px; x <= radius_px; ++x, ++i) {
      const SmoothedPixel pixel{grid.value(y + radius_px, x + radius_px),
                                grid.gradient_x(y + radius_px, x + radius_px),
                                grid.gradient_y(y + radius_px, x + radius_px)};
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

  const SmallMatrix normal = (patch.design_.transpose() * patch.weighted_).cast<double>();
  const Eigen::LDLT<SmallMatrix> factor(normal);
  // A patch without structure in some direction: the smallest pivot vanishes against the largest.
  const double min_pivot = factor.vectorD().minCoeff();
  if (factor.info() != Eigen::Success || !(patch.variance_ > 1e-3) || !(min_pivot > 1e-4)) {
    return std::nullopt;
  }
  patch.inverse_ = factor.solve(SmallMatrix::Identity(n, n));
  // Weighted least squares with a window that is not the inverse noise: the sandwich.
  const SmallMatrix meat = (patch.weighted_.transpose() * patch.weighted_).cast<double>();
  patch.unit_covariance_ = (patch.inverse_ * meat * patch.inverse_).topLeftCorner<2, 2>();
  return patch;
}

bool PatchTemplate::Sample(const cv::Mat& image, const PatchWarp& warp,
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
  values->resize(reference_.size());
  const int num_across = across.isZero() ? 1 : 2;
  const int num_down = down.isZero() ? 1 : 2;
  if (num_across * num_down == 1) {
    SampleOnce(image, warp, values->data());
    return true;
  }
  Eigen::VectorXf once(reference_.size());
  values->setZero();
  for (int i = 0; i < num_across; ++i) {
    for (int j = 0; j < num_down; ++j) {
      PatchWarp shifted = warp;
      shifted.center_px += (i == 0 ? across : -across) + (j == 0 ? down : -down);
      SampleOnce(image, shifted, once.data());
      *values += once;
    }
  }
  *values /= static_cast<float>(num_across * num_down);
  return true;
}

void PatchTemplate::SampleOnce(const cv::Mat& image, const PatchWarp& warp, float* value) const {
  const std::size_t step = image.step[0];
  const Eigen::Matrix2f a = warp.affine.cast<float>();
  const Eigen::Matrix<float, 2, 3> q = warp.quadratic.cast<float>();
  const Eigen::Vector2f c = warp.center_px.cast<float>();
  const cv::v_float32x4 unit = cv::v_setall_f32(1.0F / SplineTable::kOne);
  for (int y = -radius_px_; y <= radius_px_; ++y) {
    const auto fy = static_cast<float>(y);
    const float row_x = c.x() + (a(0, 1) + q(0, 2) * fy) * fy;
    const float row_y = c.y() + (a(1, 1) + q(1, 2) * fy) * fy;
    const float slope_x = a(0, 0) + q(0, 1) * fy;
    const float slope_y = a(1, 0) + q(1, 1) * fy;
    const auto cell_at = [&](int x) {
      const auto fx = static_cast<float>(x);
      return Locate(image, row_x + (slope_x + q(0, 0) * fx) * fx,
                    row_y + (slope_y + q(1, 0) * fx) * fx);
    };
    int x = -radius_px_;
    if (reading_ == PatchReading::kSmooth) {
      const auto columns_at = [&](int at) {
        const Cell cell = cell_at(at);
        return WeighColumns(cell.corner, step, kSpline.At(cell.fraction_x),
                            kSpline.At(cell.fraction_y));
      };
      for (; x + 3 <= radius_px_; x += 4, value += 4) {
        cv::v_store(value, cv::v_reduce_sum4(columns_at(x), columns_at(x + 1), columns_at(x + 2),
                                             columns_at(x + 3)) *
                               unit);
      }
      for (; x <= radius_px_; ++x) *value++ = cv::v_reduce_sum(columns_at(x) * unit);
    } else {
      for (; x <= radius_px_; ++x) *value++ = Bilinear(cell_at(x), step);
    }
  }
}

/// -1 where the values are all alike.
double PatchTemplate::Correlation(const Eigen::VectorXf& values) const {
  const auto weights = weighted_.col(num_parameters_ - 1);
  const float mean = weights.dot(values);
  const double variance = weights.dot((values.array() - mean).matrix().cwiseAbs2());
  if (!(variance > 1e-6)) return -1.0;
  return weighted_.col(num_parameters_ - 2).dot(values) / std::sqrt(variance * variance_);
}

std::optional<PatchMatch> PatchTemplate::Register(const cv::Mat& image, const PatchWarp& initial,
                                                  const PatchRegistrationLimits& limits) const {
  PatchMatch match;
  match.warp = initial;
  const int num_motion = num_parameters_ - 2;
  Eigen::VectorXf values;
  SmallVector solution(num_parameters_);
  bool converged = false;
  for (; match.iterations < limits.max_iterations && !converged; ++match.iterations) {
    if (!Sample(image, match.warp, &values)) return std::nullopt;
    solution = inverse_ * (weighted_.transpose() * values).cast<double>();
    match.gain = solution[num_motion];
    if (match.iterations == kHopelessIteration && Correlation(values) < limits.hopeless_ncc) {
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
    converged = step.norm() < limits.convergence_px && corner_step_px < 10 * limits.convergence_px;
  }
  if (!converged) return std::nullopt;

  const Eigen::VectorXf residual = values - design_ * solution.cast<float>();
  const auto weights = weighted_.col(num_parameters_ - 1);
  const double residual_variance = weights.dot(residual.cwiseAbs2());
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
