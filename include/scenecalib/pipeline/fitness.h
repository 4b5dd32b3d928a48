#pragma once

#include <string>

#include "scenecalib/base/options.h"
#include "scenecalib/base/status.h"
#include "scenecalib/mapping/segment_mapper.h"
#include "scenecalib/sensor/rig.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {

/// What a recording must offer to be calibrated on (IV-D); below, the values known before are
/// better than what would come out.
struct FitnessOptions {
  double min_brightness = 18.0;
  double min_contrast = 6.0;
  double min_contrast_over_noise = 3.0;
  int min_tracks_per_image = 20;
  double min_track_length = 3.6;
  double max_surface_thickness_m = 0.08;
  double max_airborne_share = 0.1;
  double min_path_length_m = 3.0;

  void Visit(OptionVisitor& v) {
    v.Field("min_brightness", &min_brightness, {0.0, 255.0},
            "mean grey value of a camera's typical image; darker is night");
    v.Field("min_contrast", &min_contrast, {0.0, 127.0},
            "standard deviation of its grey values; less is fog, or a covered lens");
    v.Field("min_contrast_over_noise", &min_contrast_over_noise, {0.0, 1000.0},
            "the same over its pixel noise; less is noise");
    v.Field("min_tracks_per_image", &min_tracks_per_image, {0, 100000},
            "verified feature tracks seen in an image, on average");
    v.Field("min_track_length", &min_track_length, {2.0, 1000.0},
            "images over which a verified track lasts, on average; rain and snow make features "
            "that do not stay");
    v.Field("max_surface_thickness_m", &max_surface_thickness_m, {0.001, 10.0},
            "median thickness of the lidar's surfaces; more is a map that is doubled or full of "
            "snow");
    v.Field(
        "max_airborne_share", &max_airborne_share, {0.0, 1.0},
        "share of the lidar's returns that hang in the air near it: snow, rain or dust; without "
        "any it is below 0.006, with flakes in a quarter of the beams 0.12");
    v.Field("min_path_length_m", &min_path_length_m, {0.0, 1000.0},
            "distance driven; nothing shows the position of a camera on a vehicle that stands");
  }
};

/// What of a camera's images decides, as measured.
struct CameraFitness {
  double brightness = 0.0;  ///< medians over some images
  double contrast = 0.0;
  double noise = 0.0;
  double tracks_per_image = 0.0;
  double track_length = 0.0;
};
CameraFitness MeasureFitness(const CameraSegment& segment);

/// Why a camera's images are not fit to calibrate on, in words, with measure and limit; empty when
/// they are.
std::string WhyUnfit(const CameraFitness& fitness, const FitnessOptions& options);

/// InsufficientData when the map is not fit for any camera.
Status CheckMapFitness(const MappingReport& report, const FitnessOptions& options);

}  // namespace scenecalib
