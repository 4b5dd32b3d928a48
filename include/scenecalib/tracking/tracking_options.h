#pragma once

#include "scenecalib/base/options.h"

namespace scenecalib {

/// Where new features are looked for.
struct DetectionOptions {
  int max_features = 1500;
  double min_distance_px = 7.5;
  double max_wide_factor = 1.5;
  int bucket_px = 64;
  double bucket_share = 8.0;
  double min_relative_score = 1e-3;
  double min_contrast = 6.0;

  void Visit(OptionVisitor& v) {
    v.Field("max_features", &max_features, {50, 200000}, "live features aimed at in every image");
    v.Field("min_distance_px", &min_distance_px, {1, 100}, "distance kept between two features");
    v.Field("max_wide_factor", &max_wide_factor, {1, 10},
            "a camera that sees beyond 45 degrees from its axis is given more features, nearer to "
            "each other, in proportion to that angle and by up to this factor: what it sees passes "
            "by quickly");
    v.Field("bucket_px", &bucket_px, {16, 1024}, "edge of a bucket that features are spread over");
    v.Field(
        "bucket_share", &bucket_share, {1, 100},
        "features a bucket may hold where they can be followed, as a multiple of the even share");
    v.Field("min_relative_score", &min_relative_score, {0, 1},
            "smallest corner score as a share of the image's strongest corner");
    v.Field("min_contrast", &min_contrast, {0, 255},
            "standard deviation of grey values below which an image is not searched at all");
  }
};

/// Following a feature from one image to the next, before it is registered precisely.
struct FlowOptions {
  int full_size_width_px = 640;
  int window_px = 11;
  int pyramid_levels = 3;
  double max_forward_backward_px = 1.5;
  double dark_mean = 45.0;
  int max_gap_images = 5;
  double merge_distance_px = 4.0;

  void Visit(OptionVisitor& v) {
    v.Field("full_size_width_px", &full_size_width_px, {100, 20000},
            "images up to this wide are searched at their full resolution, up to thrice this at "
            "half of it, ...; features are found there too");
    v.Field("window_px", &window_px, {5, 61}, "edge of the Lucas-Kanade window, reduced pixels");
    v.Field("pyramid_levels", &pyramid_levels, {0, 8},
            "pyramid levels above the finest one that is searched");
    v.Field("max_forward_backward_px", &max_forward_backward_px, {0.05, 20},
            "tracking there and back must return this close");
    v.Field("dark_mean", &dark_mean, {0, 255},
            "images with a lower mean grey value are equalised (CLAHE) for detection and flow; "
            "registration always uses the grey values as they came");
    v.Field("max_gap_images", &max_gap_images, {0, 100},
            "images over which a lost feature is looked for again");
    v.Field("merge_distance_px", &merge_distance_px, {0.5, 100},
            "two live tracks nearer than this follow the same thing: the younger ends");
  }
};

/// Registering every observation against the patch of its track's reference view.
struct RegistrationOptions {
  int max_tracks = 0;
  int live_radius_px = 7;
  int radius_px = 10;
  int max_iterations = 12;
  double convergence_px = 0.03;
  double min_live_ncc = 0.75;
  double min_ncc = 0.85;
  double max_live_scale = 1.35;
  double max_scale = 2.5;
  double max_correction_px = 3.0;
  double max_sigma_px = 0.1;
  double max_misfit_px = 0.1;
  double few_tracks_share = 0.13;
  double few_tracks_sigma_px = 0.2;
  double max_view_sigma_px = 0.06;
  double max_end_sigma_px = 0.15;
  double sigma_floor_px = 0.02;
  double noise_correlation = 4.0;
  double max_residual_noise = 2.0;
  double max_residual_contrast = 0.04;
  double max_part_shift_px = 0.45;
  double max_center_shift_px = 0.1;
  int core_radius_px = 6;
  double max_core_sigma_px = 0.1;
  double max_core_residual = 0.6;

  void Visit(OptionVisitor& v) {
    v.Field("max_tracks", &max_tracks, {0, 10000000},
            "tracks of a camera that are registered when a segment is asked for, long ones first, "
            "spread over image and time (up to three times as many of more than ten seconds, up to "
            "twice as many of a camera narrower than 72 degrees from corner to corner); 0 for all");
    v.Field("live_radius_px", &live_radius_px, {3, 30},
            "half edge of the patch that keeps a live track from drifting");
    v.Field("radius_px", &radius_px, {3, 40}, "half edge of the patch of the final registration");
    v.Field("max_iterations", &max_iterations, {1, 100}, "Gauss-Newton steps");
    v.Field("convergence_px", &convergence_px, {1e-5, 1}, "step that ends the iteration");
    v.Field("min_live_ncc", &min_live_ncc, {-1, 1}, "correlation below which a live track ends");
    v.Field("min_ncc", &min_ncc, {-1, 1}, "correlation below which an observation is dropped");
    v.Field("max_live_scale", &max_live_scale, {1.05, 10},
            "change of scale at which a live track takes a new patch to compare with");
    v.Field("max_scale", &max_scale, {1.05, 10},
            "largest change of scale, in any direction, between an observation and its reference; "
            "a track that changes more is split");
    v.Field("max_correction_px", &max_correction_px, {0.1, 50},
            "registration may move an observation this far from where the flow put it");
    v.Field(
        "max_sigma_px", &max_sigma_px, {0.01, 10},
        "observations less certain than this, in any direction, in their own pixels or those of "
        "the reference view, are dropped");
    v.Field("max_misfit_px", &max_misfit_px, {0.001, 10},
            "the same for what of the uncertainty the image noise does not explain");
    v.Field("few_tracks_share", &few_tracks_share, {0, 1},
            "where fewer tracks are left in an image, on average, than this share of "
            "detection.max_features...");
    v.Field("few_tracks_sigma_px", &few_tracks_sigma_px, {0.01, 10},
            "...both, and max_end_sigma_px, may be this, if that is more: tracks that tell less "
            "are better than few (not in noisy images, which have limits of their own)");
    v.Field("max_view_sigma_px", &max_view_sigma_px, {0, 10},
            "where the scale has changed too much for the reference view, a sighting more certain "
            "than this takes its place for those beyond it; 0: none");
    v.Field("max_end_sigma_px", &max_end_sigma_px, {0.001, 10},
            "a track is carried on as long as either end's uncertainty, as large as the other end "
            "sees it, stays below this");
    v.Field("sigma_floor_px", &sigma_floor_px, {0, 1},
            "error of a registration that its residual does not show, added to its covariance");
    v.Field("noise_correlation", &noise_correlation, {1, 100},
            "by how much neighbouring residuals' correlation inflates the covariance");
    v.Field("max_residual_noise", &max_residual_noise, {0, 100},
            "an observation may differ from its reference by this multiple of the image noise "
            "(both as deviations)...");
    v.Field("max_residual_contrast", &max_residual_contrast, {0, 1},
            "...and this share of the image's contrast, squares added: more means that the patch "
            "holds things at different depths");
    v.Field("max_part_shift_px", &max_part_shift_px, {0.05, 100},
            "how far a quarter of the patch may lie from where the whole patch puts it");
    v.Field("max_center_shift_px", &max_center_shift_px, {0.0, 100},
            "the same of the patch's centre, beside two of its standard deviations");
    v.Field("core_radius_px", &core_radius_px, {3, 40},
            "half edge of the patch's core, which may match alone where the whole does not");
    v.Field("max_core_sigma_px", &max_core_sigma_px, {0.01, 10},
            "an observation by the core alone has to be this certain");
    v.Field("max_core_residual", &max_core_residual, {0, 10},
            "share of the permitted difference that an observation by the core alone may have");
  }
};

/// What is done differently when images are noisy for what they show, as at night.
struct NoisyImageOptions {
  double min_noise_share = 0.2;
  double blur_px = 1.2;
  int radius_px = 16;
  double max_scale = 1.6;
  double max_sigma_px = 0.3;
  double max_misfit_px = 0.03;
  double max_residual_noise = 1.1;
  double max_residual_contrast = 0.01;
  double max_part_shift_px = 0.8;
  double max_center_shift_px = 0.8;
  int min_observations = 4;
  double max_outlier_share = 0.05;

  void Visit(OptionVisitor& v) {
    v.Field("min_noise_share", &min_noise_share, {0, 100},
            "images with more noise, as a share of their contrast (both as deviations), are noisy");
    v.Field("blur_px", &blur_px, {0.3, 10},
            "deviation of the Gaussian under which noisy images are registered");
    v.Field("radius_px", &radius_px, {3, 40}, "registration.radius_px for noisy images");
    v.Field("max_scale", &max_scale, {1.05, 10}, "registration.max_scale likewise");
    v.Field("max_sigma_px", &max_sigma_px, {0.01, 10}, "registration.max_sigma_px likewise");
    v.Field("max_misfit_px", &max_misfit_px, {0.001, 10}, "registration.max_misfit_px likewise");
    v.Field("max_residual_noise", &max_residual_noise, {0, 100},
            "registration.max_residual_noise likewise");
    v.Field("max_residual_contrast", &max_residual_contrast, {0, 1},
            "registration.max_residual_contrast likewise");
    v.Field("max_part_shift_px", &max_part_shift_px, {0.05, 100},
            "registration.max_part_shift_px likewise");
    v.Field("max_center_shift_px", &max_center_shift_px, {0.0, 100},
            "registration.max_center_shift_px likewise");
    v.Field("min_observations", &min_observations, {2, 1000},
            "verification.min_observations likewise");
    v.Field("max_outlier_share", &max_outlier_share, {0, 1},
            "verification.max_outlier_share likewise");
  }
};

/// Which tracks are believed.
struct VerificationOptions {
  int min_observations = 3;
  int enough_tracks = 800;
  double static_extent_px = 1.0;
  double min_neighbour_motion_px = 4.0;
  int frame_gap = 3;
  int ransac_iterations = 200;
  double max_epipolar_error_px = 0.7;
  double max_outlier_share = 0.25;
  double min_motion_px = 1.0;
  int min_tracks_in_dark = 150;

  void Visit(OptionVisitor& v) {
    v.Field("min_observations", &min_observations, {2, 1000}, "shorter tracks are dropped");
    v.Field("enough_tracks", &enough_tracks, {0, 1000000},
            "where more tracks than these are left in an image, on average, the shortest are "
            "dropped; 0: none are");
    v.Field("static_extent_px", &static_extent_px, {0, 20},
            "a track that stays within this while its neighbours move is fixed to the vehicle");
    v.Field("min_neighbour_motion_px", &min_neighbour_motion_px, {0.5, 1000},
            "how far a track's neighbours must have moved in its life to call it static");
    v.Field("frame_gap", &frame_gap, {1, 100}, "images between the two of an epipolar check");
    v.Field("ransac_iterations", &ransac_iterations, {10, 100000}, "samples per pair of images");
    v.Field("max_epipolar_error_px", &max_epipolar_error_px, {0.05, 50},
            "Sampson distance beyond which a pair of observations contradicts the motion");
    v.Field("max_outlier_share", &max_outlier_share, {0, 1},
            "share of such pairs at which the whole track is dropped");
    v.Field("min_motion_px", &min_motion_px, {0, 100},
            "median motion below which a pair of images cannot be checked");
    v.Field("min_tracks_in_dark", &min_tracks_in_dark, {0, 100000},
            "a dark camera with fewer verified tracks in an image, on average, says that it is too "
            "dark");
  }
};

/// Which parts of the image are fixed to the vehicle.
struct StaticRegionOptions {
  int min_samples = 8;
  double min_motion_px = 6.0;
  double min_gradient = 1.0;
  double min_lasting_share = 0.6;
  double max_share = 0.5;

  void Visit(OptionVisitor& v) {
    v.Field("min_samples", &min_samples, {0, 1000},
            "looks at a tile, with the scene's motion between them, before it is judged; 0: static "
            "regions are not looked for");
    v.Field("min_motion_px", &min_motion_px, {1, 1000}, "that motion");
    v.Field("min_gradient", &min_gradient, {0.1, 100},
            "grey levels a reduced pixel (RMS, along the scene's motion) below which a tile is "
            "empty");
    v.Field("min_lasting_share", &min_lasting_share, {0.1, 1},
            "share of the gradients' energy that stays in place in a static tile");
    v.Field("max_share", &max_share, {0, 1},
            "of the image; where more looks static nothing is taken for static");
  }
};

/// How much of the past a tracker keeps.
struct ImageBufferOptions {
  int max_images = 600;
  int max_memory_mib = 512;
  double min_motion_px = 0.5;
  void Visit(OptionVisitor& v) {
    v.Field("max_images", &max_images, {10, 100000},
            "images kept per camera; beyond it the oldest are forgotten with their observations");
    v.Field("max_memory_mib", &max_memory_mib, {1, 1000000},
            "memory for a camera's grey images, and as much for its colour images; older ones lie "
            "in temporary files ($TMPDIR, else /tmp) until they are looked at");
    v.Field("min_motion_px", &min_motion_px, {0, 100},
            "an image in which four features of five moved less than this shows nothing new, as at "
            "a standstill, and is not kept; 0 keeps all");
  }
};

/// Everything that steers feature tracking.
struct TrackingOptions {
  ImageBufferOptions buffer;
  DetectionOptions detection;
  FlowOptions flow;
  RegistrationOptions registration;
  NoisyImageOptions noisy;
  VerificationOptions verification;
  StaticRegionOptions static_regions;
  void Visit(OptionVisitor& v) {
    v.Group("buffer", &buffer);
    v.Group("detection", &detection);
    v.Group("flow", &flow);
    v.Group("registration", &registration);
    v.Group("noisy", &noisy);
    v.Group("verification", &verification);
    v.Group("static_regions", &static_regions);
  }
};

}  // namespace scenecalib
