#include "scenecalib/evaluation/miscalibration_rate.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include "best_pose.h"
#include "image_pairs.h"
#include "scenecalib/base/random.h"

// Map of this file: the rater collects the pairs (image_pairs.h) and each camera's best pose
// (best_pose.h); RateCamera perturbs.

namespace scenecalib {
namespace {

using Rates = std::vector<std::optional<MiscalibrationRate>>;
using AxisValues = Eigen::Array<double, kNumAxes, 1>;

/// Sums over the points of the truncated squared difference, for each value of one axis of a scaled
/// pose. Point by point, because the values move it by few pixels.
std::vector<double> PhotometricErrors(const Comparison& comparison, const ScaledPose& pose,
                                      int axis, const std::vector<float>& values) {
  Eigen::Matrix<float, kNumAxes, 1> p = pose.cast<float>();
  p[axis] = 0.0F;
  constexpr auto kMaxSquare = static_cast<float>(kMaxDifference * kMaxDifference);
  const std::size_t count = values.size();
  std::vector<double> sums(count, 0.0);
  std::vector<float> x(count), y(count), brightness(count), other_brightness(count);
  const auto read = [&](const BandPassImage& image, const Eigen::Vector2f& pixel,
                        const Eigen::Vector2f& by_value, std::vector<float>* out) {
    for (std::size_t k = 0; k < count; ++k) {
      x[k] = pixel.x() + values[k] * by_value.x();
      y[k] = pixel.y() + values[k] * by_value.y();
    }
    image.At(x.data(), y.data(), count, out->data());
  };
  for (std::size_t i = 0; i < comparison.pixels.size(); ++i) {
    read(*comparison.image, comparison.pixels[i] + comparison.pixels_by_pose[i] * p,
         comparison.pixels_by_pose[i].col(axis), &brightness);
    if (comparison.same_camera) {
      read(*comparison.other_image,
           comparison.other_pixels[i] + comparison.other_pixels_by_pose[i] * p,
           comparison.other_pixels_by_pose[i].col(axis), &other_brightness);
    } else {
      std::fill(other_brightness.begin(), other_brightness.end(), comparison.other_values[i]);
    }
    for (std::size_t k = 0; k < count; ++k) {
      const float difference = brightness[k] - other_brightness[k];
      sums[k] += std::min(difference * difference, kMaxSquare);
    }
  }
  return sums;
}

/// Share of the perturbed poses that look better than the given one, axis by axis.
AxisValues RateCamera(const std::vector<Comparison>& comparisons,
                      const std::vector<std::size_t>& pairs, const ScaledPose& optimum,
                      const std::vector<double>& fractions, const MiscalibrationOptions& options) {
  const ScaledPose base = options.free_other_axes ? optimum : ScaledPose(ScaledPose::Zero());
  const auto num_samples = static_cast<std::size_t>(options.num_samples);
  AxisValues rates;
  for (int axis = 0; axis < kNumAxes; ++axis) {
    // The given pose first, then the perturbed ones.
    std::vector<float> values = {0.0F};
    const auto first = fractions.begin() + axis * options.num_samples;
    values.insert(values.end(), first, first + options.num_samples);
    std::vector<std::vector<double>> errors(pairs.size());
    tbb::parallel_for(std::size_t{0}, pairs.size(), [&](std::size_t i) {
      errors[i] = PhotometricErrors(comparisons[pairs[i]], base, axis, values);
    });
    std::vector<double> sums(values.size(), 0.0);
    for (const std::vector<double>& of_pair : errors) {
      std::transform(sums.begin(), sums.end(), of_pair.begin(), sums.begin(), std::plus<>());
    }
    const auto num_lower = std::count_if(sums.begin() + 1, sums.end(),
                                         [&](double error) { return error < sums.front(); });
    rates[axis] = static_cast<double>(num_lower) / static_cast<double>(num_samples);
  }
  return rates;
}

std::vector<double> DrawFractions(const MiscalibrationOptions& options) {
  Random random(static_cast<std::uint64_t>(options.seed));
  std::vector<double> fractions;
  for (int i = 0; i < kNumAxes * options.num_samples; ++i) {
    // One in each of num_samples equal parts of the range: uniform, with less chance in the count.
    const double part = i % options.num_samples;
    fractions.push_back(-1.0 + 2.0 * (part + random.Uniform()) / options.num_samples);
  }
  return fractions;
}

Status CheckImages(const Rig& rig, const std::vector<const std::map<Timestamp, cv::Mat>*>& images) {
  if (images.size() == rig.cameras.size()) return Status::Ok();
  return Status::InvalidArgument("miscalibration rate: images of " + std::to_string(images.size()) +
                                 " cameras for a rig of " + std::to_string(rig.cameras.size()));
}

}  // namespace

FieldOfView FieldOfViewOf(const CameraModel& camera) {
  const double across_deg = 2.0 * camera.max_theta_rad() * 180.0 / 3.14159265358979323846;
  if (across_deg < 50.0) return FieldOfView::kNarrow;
  return across_deg < 160.0 ? FieldOfView::kMedium : FieldOfView::kWide;
}

const char* ToString(FieldOfView field_of_view) {
  switch (field_of_view) {
    case FieldOfView::kNarrow:
      return "30 deg";
    case FieldOfView::kMedium:
      return "70, 120 deg";
    case FieldOfView::kWide:
      break;
  }
  return "200 deg";
}

MiscalibrationRate PublishedRate(FieldOfView field_of_view) {
  switch (field_of_view) {
    case FieldOfView::kNarrow:
      return {0.265, 0.308, 0.205, 0.273, 0.155, 0.265};
    case FieldOfView::kMedium:
      return {0.210, 0.227, 0.174, 0.185, 0.150, 0.173};
    case FieldOfView::kWide:
      break;
  }
  return {0.045, 0.070, 0.066, 0.119, 0.183, 0.126};
}

struct MiscalibrationRater::Impl {
  const SceneMap& map;
  const RayCaster& surfaces;
  std::vector<const std::map<Timestamp, cv::Mat>*> images;
  MiscalibrationOptions options;
  BandPassImages band_pass;  ///< of the rigs so far
};

MiscalibrationRater::MiscalibrationRater(const SceneMap& map, const RayCaster& surfaces,
                                         std::vector<const std::map<Timestamp, cv::Mat>*> images,
                                         const MiscalibrationOptions& options)
    : impl_(new Impl{map, surfaces, std::move(images), options, {}}) {}
MiscalibrationRater::~MiscalibrationRater() = default;

Result<Rates> MiscalibrationRater::Rate(const Rig& rig, const std::atomic<bool>& cancelled) {
  const MiscalibrationOptions& options = impl_->options;
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  SCENECALIB_RETURN_IF_ERROR(CheckImages(rig, impl_->images));
  Rates rates(rig.cameras.size());
  if (impl_->map.map_from_lidar.empty()) return rates;
  const Status stopped = Status::Cancelled("miscalibration rate: stopped");
  const auto [comparisons, pairs_of_camera] = CollectImagePairs(
      rig, impl_->map, impl_->surfaces, impl_->images, options, cancelled, &impl_->band_pass);
  if (cancelled) return stopped;
  const std::vector<ScaledPose> optima = FindBestPoses(comparisons, pairs_of_camera);
  const std::vector<double> fractions = DrawFractions(options);
  for (std::size_t camera = 0; camera < rates.size(); ++camera) {
    if (cancelled) return stopped;
    if (pairs_of_camera[camera].empty()) continue;
    const AxisValues r =
        RateCamera(comparisons, pairs_of_camera[camera], optima[camera], fractions, options);
    // Rotations by axis are about right (pitch), down (yaw) and forward (roll).
    rates[camera] = MiscalibrationRate{r[0], r[1], r[2], r[5], r[3], r[4]};
  }
  return rates;
}

Result<std::vector<Rates>> ComputeMiscalibrationRates(
    const std::vector<Rig>& rigs, const SceneMap& map,
    const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
    const MiscalibrationOptions& options) {
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  std::vector<Rates> rates;
  for (const Rig& rig : rigs) {
    SCENECALIB_RETURN_IF_ERROR(CheckImages(rig, images));
    rates.emplace_back(rig.cameras.size());
  }
  const Result<RayCaster> surfaces = RayCaster::Create(map);
  if (!surfaces.ok()) return rates;  // hence no point to compare
  MiscalibrationRater rater(map, *surfaces, images, options);
  for (std::size_t i = 0; i < rigs.size(); ++i) {
    Result<Rates> of_rig = rater.Rate(rigs[i], std::atomic<bool>(false));
    if (!of_rig.ok()) return of_rig.status();
    rates[i] = std::move(of_rig).value();
  }
  return rates;
}

Result<Rates> ComputeMiscalibrationRates(
    const Rig& rig, const SceneMap& map,
    const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
    const MiscalibrationOptions& options) {
  const Result<std::vector<Rates>> rates =
      ComputeMiscalibrationRates(std::vector<Rig>{rig}, map, images, options);
  if (!rates.ok()) return rates.status();
  return rates->front();
}

}  // namespace scenecalib
