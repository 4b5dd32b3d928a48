#include "scenecalib/evaluation/miscalibration_rate.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include "image_pairs.h"
#include "scenecalib/base/random.h"

// Map of this file: FindOptima finds each camera's best pose over all its pairs (image_pairs.h);
// RateCamera perturbs.

namespace scenecalib {
namespace {

using Rates = std::vector<std::optional<MiscalibrationRate>>;
using AxisValues = Eigen::Array<double, kNumAxes, 1>;
using Vector6 = Eigen::Matrix<double, kNumAxes, 1>;
using Matrix6 = Eigen::Matrix<double, kNumAxes, kNumAxes>;

/// Differences beyond this many local contrasts are other things: cars, shadows, reflections.
constexpr double kMaxDifference = 0.5;
/// Gauss-Newton steps, from coarse to fine: the base over which brightness is differentiated, and
/// the difference beyond which a point does not count.
struct OptimumStep {
  float gradient_base_px;
  double max_difference;
};
constexpr OptimumStep kSteps[] = {{3.0F, 3.0}, {3.0F, 2.0}, {2.5F, 1.5}, {2.0F, 1.0},
                                  {1.5F, 0.8}, {1.0F, 0.5}, {1.0F, 0.5}, {1.0F, 0.5}};

/// Sums over the points of the truncated squared difference, for each value of one axis of a scaled
/// pose. Point by point, because the values move it by few pixels.
std::vector<double> PhotometricErrors(const Comparison& comparison, const Vector6& pose, int axis,
                                      const std::vector<float>& values) {
  Eigen::Matrix<float, kNumAxes, 1> p = pose.cast<float>();
  p[axis] = 0.0F;
  constexpr auto kMaxSquare = static_cast<float>(kMaxDifference * kMaxDifference);
  std::vector<double> sums(values.size(), 0.0);
  for (std::size_t i = 0; i < comparison.pixels.size(); ++i) {
    const Eigen::Vector2f pixel = comparison.pixels[i] + comparison.pixels_by_pose[i] * p;
    const Eigen::Vector2f by_value = comparison.pixels_by_pose[i].col(axis);
    Eigen::Vector2f other_pixel = comparison.other_pixels[i];
    Eigen::Vector2f other_by_value = Eigen::Vector2f::Zero();
    if (comparison.same_camera) {
      other_pixel += comparison.other_pixels_by_pose[i] * p;
      other_by_value = comparison.other_pixels_by_pose[i].col(axis);
    }
    for (std::size_t k = 0; k < values.size(); ++k) {
      const Eigen::Vector2f moved = pixel + values[k] * by_value;
      const Eigen::Vector2f other_moved = other_pixel + values[k] * other_by_value;
      const float other_value = comparison.same_camera
                                    ? comparison.other_image->At(other_moved.x(), other_moved.y())
                                    : comparison.other_values[i];
      const float difference = comparison.image->At(moved.x(), moved.y()) - other_value;
      sums[k] += std::min(difference * difference, kMaxSquare);
    }
  }
  return sums;
}

/// Normal equations of the differences that are not truncated.
struct Normal {
  Matrix6 h = Matrix6::Zero();
  Vector6 b = Vector6::Zero();
  double square_sum = 0.0;
  int count = 0;

  void Add(const Normal& other) {
    h += other.h;
    b += other.b;
    square_sum += other.square_sum;
    count += other.count;
  }
};

Eigen::RowVector2f Gradient(const BandPassImage& image, const Eigen::Vector2f& pixel,
                            float base_px) {
  const float half = 0.5F * base_px;
  return Eigen::RowVector2f(
             image.At(pixel.x() + half, pixel.y()) - image.At(pixel.x() - half, pixel.y()),
             image.At(pixel.x(), pixel.y() + half) - image.At(pixel.x(), pixel.y() - half)) /
         base_px;
}

Normal Linearise(const Comparison& comparison, const Vector6& pose, const OptimumStep& step) {
  const Eigen::Matrix<float, kNumAxes, 1> p = pose.cast<float>();
  Normal normal;
  for (std::size_t i = 0; i < comparison.pixels.size(); ++i) {
    const Eigen::Vector2f pixel = comparison.pixels[i] + comparison.pixels_by_pose[i] * p;
    Eigen::Vector2f other_pixel = comparison.other_pixels[i];
    if (comparison.same_camera) other_pixel += comparison.other_pixels_by_pose[i] * p;
    const double difference = comparison.image->At(pixel.x(), pixel.y()) -
                              comparison.other_image->At(other_pixel.x(), other_pixel.y());
    if (std::abs(difference) >= step.max_difference) continue;
    Eigen::Matrix<float, 1, kNumAxes> by_pose =
        Gradient(*comparison.image, pixel, step.gradient_base_px) * comparison.pixels_by_pose[i];
    if (comparison.same_camera) {
      by_pose -= Gradient(*comparison.other_image, other_pixel, step.gradient_base_px) *
                 comparison.other_pixels_by_pose[i];
    }
    const Vector6 row = by_pose.transpose().cast<double>();
    normal.h += row * row.transpose();
    normal.b += difference * row;
    normal.square_sum += difference * difference;
    ++normal.count;
  }
  return normal;
}

/// Each camera's best scaled pose over all its pairs with other cameras, within the perturbations'
/// range. One camera's images at two times do not fix all six axes: there it is the given pose.
std::vector<Vector6> FindOptima(const std::vector<Comparison>& comparisons,
                                const std::vector<std::vector<std::size_t>>& pairs_of_camera) {
  std::vector<Vector6> optima(pairs_of_camera.size(), Vector6::Zero());
  for (const OptimumStep& step : kSteps) {
    std::vector<Normal> normals(comparisons.size());
    std::vector<std::pair<std::size_t, std::size_t>> tasks;  // camera, comparison
    for (std::size_t camera = 0; camera < pairs_of_camera.size(); ++camera) {
      for (const std::size_t i : pairs_of_camera[camera]) {
        if (!comparisons[i].same_camera) tasks.emplace_back(camera, i);
      }
    }
    tbb::parallel_for(std::size_t{0}, tasks.size(), [&](std::size_t t) {
      const auto& [camera, i] = tasks[t];
      normals[i] = Linearise(comparisons[i], optima[camera], step);
    });
    for (std::size_t camera = 0; camera < pairs_of_camera.size(); ++camera) {
      Normal sum;
      for (const std::size_t i : pairs_of_camera[camera]) sum.Add(normals[i]);
      if (sum.count == 0) continue;
      // What the images do not show stays at the calibration: a prior of one range per axis.
      const double variance = sum.square_sum / sum.count;
      sum.h.diagonal().array() += variance;
      sum.b += variance * optima[camera];
      optima[camera] -= sum.h.ldlt().solve(sum.b);
      optima[camera] = optima[camera].cwiseMax(-1.0).cwiseMin(1.0);
    }
  }
  return optima;
}

/// Share of the perturbed poses that look better than the given one, axis by axis.
AxisValues RateCamera(const std::vector<Comparison>& comparisons,
                      const std::vector<std::size_t>& pairs, const Vector6& optimum,
                      const std::vector<double>& fractions, const MiscalibrationOptions& options) {
  const Vector6 base = options.free_other_axes ? optimum : Vector6(Vector6::Zero());
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

Rates RateRig(const Rig& rig, const SceneMap& map, const RayCaster& caster,
              const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
              const MiscalibrationOptions& options, BandPassImages* band_pass) {
  Rates rates(rig.cameras.size());
  const auto [comparisons, pairs_of_camera] =
      CollectImagePairs(rig, map, caster, images, options, band_pass);
  const std::vector<Vector6> optima = FindOptima(comparisons, pairs_of_camera);
  const std::vector<double> fractions = DrawFractions(options);
  for (std::size_t camera = 0; camera < rates.size(); ++camera) {
    if (pairs_of_camera[camera].empty()) continue;
    const AxisValues r =
        RateCamera(comparisons, pairs_of_camera[camera], optima[camera], fractions, options);
    // Rotations by axis are about right (pitch), down (yaw) and forward (roll).
    rates[camera] = MiscalibrationRate{r[0], r[1], r[2], r[5], r[3], r[4]};
  }
  return rates;
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

Result<std::vector<Rates>> ComputeMiscalibrationRates(
    const std::vector<Rig>& rigs, const SceneMap& map,
    const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
    const MiscalibrationOptions& options) {
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  std::vector<Rates> rates;
  for (const Rig& rig : rigs) {
    if (images.size() != rig.cameras.size()) {
      return Status::InvalidArgument("miscalibration rate: images of " +
                                     std::to_string(images.size()) + " cameras for a rig of " +
                                     std::to_string(rig.cameras.size()));
    }
    rates.emplace_back(rig.cameras.size());
  }
  if (map.map_from_lidar.empty()) return rates;
  const Result<RayCaster> caster = RayCaster::Create(map);
  if (!caster.ok()) return rates;  // no surface, hence no point to compare
  BandPassImages band_pass;
  for (std::size_t i = 0; i < rigs.size(); ++i) {
    rates[i] = RateRig(rigs[i], map, *caster, images, options, &band_pass);
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
