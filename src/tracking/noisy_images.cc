#include "scenecalib/tracking/noisy_images.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace scenecalib {
namespace {

constexpr double kPi = 3.14159265358979323846;
/// Variance of the cubic B-spline kernel that patches are read through, px^2.
constexpr double kSplineVariancePx2 = 1.0 / 3.0;

/// Deviation of the Gaussian that smoothing and reading amount to.
double ReadingSigmaPx(double blur_px) { return std::sqrt(blur_px * blur_px + kSplineVariancePx2); }

}  // namespace

bool IsNoisy(const ImageQuality& quality, const NoisyImageOptions& options) {
  return quality.noise_levels > options.min_noise_share * quality.contrast;
}

TrackingOptions ForNoisyImages(const TrackingOptions& options) {
  const NoisyImageOptions& noisy = options.noisy;
  TrackingOptions adapted = options;
  RegistrationOptions& registration = adapted.registration;
  const double sigma_px = ReadingSigmaPx(noisy.blur_px);
  // Pixels over which noise under a Gaussian is one and the same: the sum of its correlation.
  registration.noise_correlation = 4.0 * kPi * sigma_px * sigma_px;
  registration.radius_px = noisy.radius_px;
  registration.max_scale = std::min(registration.max_scale, noisy.max_scale);
  registration.max_sigma_px = noisy.max_sigma_px;
  registration.max_misfit_px = noisy.max_misfit_px;
  registration.max_residual_noise = noisy.max_residual_noise;
  registration.max_residual_contrast = noisy.max_residual_contrast;
  registration.max_part_shift_px = noisy.max_part_shift_px;
  registration.max_center_shift_px = noisy.max_center_shift_px;
  adapted.verification.min_observations =
      std::max(options.verification.min_observations, noisy.min_observations);
  adapted.verification.max_outlier_share =
      std::min(options.verification.max_outlier_share, noisy.max_outlier_share);
  return adapted;
}

ImageQuality AfterSmoothing(const ImageQuality& quality, const NoisyImageOptions& options) {
  ImageQuality smoothed = quality;
  smoothed.noise_levels *= ReadingSigmaPx(0.0) / ReadingSigmaPx(options.blur_px);
  return smoothed;
}

Status Smooth(const std::map<Timestamp, cv::Mat>& images, double blur_px, ImageStore* smoothed) {
  for (const auto& [stamp_ns, image] : images) {
    cv::Mat smooth;
    cv::GaussianBlur(image, smooth, {0, 0}, blur_px);
    SCENECALIB_RETURN_IF_ERROR(smoothed->Add(stamp_ns, smooth));
  }
  return Status::Ok();
}

}  // namespace scenecalib
