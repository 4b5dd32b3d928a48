#include "scenecalib/pipeline/fitness.h"

#include <algorithm>
#include <cstdio>
#include <vector>

#include "scenecalib/tracking/image_quality.h"

namespace scenecalib {
namespace {

constexpr std::size_t kMaxImages = 15;

template <typename... Args>
std::string Format(const char* format, Args... args) {
  char text[512];
  std::snprintf(text, sizeof(text), format, args...);
  return text;
}

double Median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

CameraFitness MeasureFitness(const CameraSegment& segment) {
  CameraFitness fitness;
  if (segment.images.empty()) return fitness;
  std::vector<double> brightness;
  std::vector<double> contrast;
  std::vector<double> noise;
  const std::size_t stride = segment.images.size() / kMaxImages + 1;
  std::size_t index = 0;
  for (const auto& [stamp_ns, image] : segment.images) {
    if (index++ % stride != 0) continue;
    const ImageQuality quality = MeasureImageQuality(image, cv::Mat());
    brightness.push_back(quality.mean);
    contrast.push_back(quality.contrast);
    noise.push_back(quality.noise_levels);
  }
  fitness.brightness = Median(std::move(brightness));
  fitness.contrast = Median(std::move(contrast));
  fitness.noise = Median(std::move(noise));
  std::size_t num_observations = 0;
  for (const Track& track : segment.tracks) num_observations += track.observations.size();
  fitness.tracks_per_image =
      static_cast<double>(num_observations) / static_cast<double>(segment.images.size());
  if (!segment.tracks.empty()) {
    fitness.track_length =
        static_cast<double>(num_observations) / static_cast<double>(segment.tracks.size());
  }
  return fitness;
}

std::string WhyUnfit(const CameraFitness& fitness, const FitnessOptions& options) {
  if (fitness.brightness < options.min_brightness) {
    return Format("too dark: mean grey value %.1f, limit %.1f: record in daylight",
                  fitness.brightness, options.min_brightness);
  }
  if (fitness.contrast < options.min_contrast) {
    return Format(
        "too little contrast: grey values spread by %.1f, limit %.1f: sky, fog or a "
        "covered lens",
        fitness.contrast, options.min_contrast);
  }
  if (fitness.contrast < options.min_contrast_over_noise * fitness.noise) {
    return Format(
        "too noisy: grey values spread by %.1f with pixel noise of %.1f, limit %.1f times "
        "that: night, or rain and snow in the air",
        fitness.contrast, fitness.noise, options.min_contrast_over_noise);
  }
  if (fitness.tracks_per_image < options.min_tracks_per_image) {
    return Format(
        "too few features: %.1f tracks in an image, limit %d: sky, fog, a covered lens, rain or "
        "snow",
        fitness.tracks_per_image, options.min_tracks_per_image);
  }
  if (fitness.track_length < options.min_track_length) {
    return Format(
        "features do not last: %.1f images on average, limit %.1f: rain, snow or dirt on "
        "the lens, or little but foliage to see",
        fitness.track_length, options.min_track_length);
  }
  return {};
}

Status CheckMapFitness(const MappingReport& report, const FitnessOptions& options) {
  if (report.airborne_share > options.max_airborne_share) {
    return Status::InsufficientData(Format(
        "lidar: %.0f %% of the returns hang in the air near the sensor, limit %.0f %%: snow, "
        "rain or dust: record in dry weather",
        100.0 * report.airborne_share, 100.0 * options.max_airborne_share));
  }
  if (report.path_length_m < options.min_path_length_m) {
    return Status::InsufficientData(
        Format("lidar: the vehicle did not move far enough (%.1f m, limit %.1f m): record while "
               "driving",
               report.path_length_m, options.min_path_length_m));
  }
  if (report.thickness_after_m > options.max_surface_thickness_m) {
    return Status::InsufficientData(Format(
        "lidar: the map is bad: its surfaces are %.3f m thick, limit %.3f m: snow or rain in "
        "the air, wrong point times, or a lost trajectory",
        report.thickness_after_m, options.max_surface_thickness_m));
  }
  return Status::Ok();
}

}  // namespace scenecalib
