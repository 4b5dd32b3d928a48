#pragma once

#include "scenecalib/association/track_association.h"
#include "scenecalib/base/options.h"
#include "scenecalib/calibration/cross_camera_matching.h"
#include "scenecalib/calibration/term_builder.h"
#include "scenecalib/calibration/track_ransac.h"
#include "scenecalib/tracking/map_guided_registration.h"

namespace scenecalib {

/// The schedule of the per-camera loop (III-D): association gates shrink geometrically, rotation is
/// freed before translation; intrinsics wait for the joint solve.
struct CoarseToFineOptions {
  int num_rounds = 8;
  double sigma_theta_start_deg = 35.0;
  double sigma_theta_end_deg = 10.0;
  double sigma_d_start_m = 1.2;
  double sigma_d_end_m = 0.06;
  int max_tracks = 1200;
  void Visit(OptionVisitor& v) {
    v.Field("num_rounds", &num_rounds, {2, 100}, "rounds of association and solve per camera");
    v.Field("sigma_theta_start_deg", &sigma_theta_start_deg, {1.0, 90.0},
            "sigma_theta (Eq. 5) of the first round");
    v.Field("sigma_theta_end_deg", &sigma_theta_end_deg, {0.5, 90.0},
            "sigma_theta (Eq. 5) of the last round and of the joint solve");
    v.Field("sigma_d_start_m", &sigma_d_start_m, {0.01, 10.0},
            "sigma_d (Eq. 8) of the first round");
    v.Field("sigma_d_end_m", &sigma_d_end_m, {0.005, 10.0},
            "sigma_d (Eq. 8) of the last round and of the joint solve");
    v.Field("max_tracks", &max_tracks, {20, 1000000}, "tracks of a camera used in this loop");
  }
};

/// The joint solve over all cameras and the trajectory correction.
struct JointOptions {
  int num_rounds = 4;
  int max_tracks_per_camera = 3000;
  double inlier_sigmas = 3.0;
  bool correct_trajectory = true;
  double correction_knot_s = 0.1;
  double correction_walk_rotation_deg = 0.015;
  double correction_walk_translation_m = 0.005;
  double min_correction_walk_rotation_deg = 0.001;
  double min_correction_walk_translation_m = 0.0005;
  bool register_through_map = true;
  void Visit(OptionVisitor& v) {
    v.Field("num_rounds", &num_rounds, {1, 100}, "rounds of association and joint solve");
    v.Field(
        "max_tracks_per_camera", &max_tracks_per_camera, {20, 10000000},
        "tracks of a camera used in the joint solve; more of long recordings and narrow cameras, "
        "as for tracking.registration.max_tracks");
    v.Field("inlier_sigmas", &inlier_sigmas, {1.0, 100.0},
            "a track takes part when its RMSE is below so many robust sigmas");
    v.Field("correct_trajectory", &correct_trajectory,
            "let the solve correct the lidar trajectory a little (the paper holds it fixed)");
    v.Field("correction_knot_s", &correction_knot_s, {0.01, 10.0},
            "spacing of the trajectory correction's knots");
    v.Field("correction_walk_rotation_deg", &correction_walk_rotation_deg, {1e-6, 10.0},
            "random walk of the correction's rotation per square root of a second, where the map "
            "does not state its trajectory's uncertainty");
    v.Field("correction_walk_translation_m", &correction_walk_translation_m, {1e-6, 1.0},
            "the same of its translation");
    v.Field("min_correction_walk_rotation_deg", &min_correction_walk_rotation_deg, {1e-6, 10.0},
            "the walk is never stiffer than this, whatever the map states");
    v.Field("min_correction_walk_translation_m", &min_correction_walk_translation_m, {1e-6, 1.0},
            "the same of its translation");
    v.Field("register_through_map", &register_through_map,
            "register the tracks' patches again through the map between the rounds");
  }
};

/// Standard deviations of the initial rig's parameters: what a drive cannot show stays there.
struct PriorOptions {
  double rotation_deg = 2.0;
  double translation_m = 0.2;
  double focal_scale = 0.005;
  double principal_point_share = 0.004;
  double time_offset_s = 0.02;
  double formal_optimism = 10.0;
  void Visit(OptionVisitor& v) {
    v.Field("rotation_deg", &rotation_deg, {1e-4, 180.0}, "of each rotation axis");
    v.Field("translation_m", &translation_m, {1e-4, 10.0}, "of each translation axis");
    v.Field("focal_scale", &focal_scale, {1e-6, 1.0}, "of s_f");
    v.Field("principal_point_share", &principal_point_share, {1e-6, 1.0},
            "of cx and cy, as a share of the image's width");
    v.Field("time_offset_s", &time_offset_s, {1e-6, 1.0}, "of the time offset");
    v.Field(
        "formal_optimism", &formal_optimism, {1.0, 1000.0},
        "by how much the formal covariance of the data may be too small: the prior of the "
        "intrinsics counts as so many times tighter, so that small errors of the map, which cost "
        "the data almost nothing, do not move principal point and rotation against each other");
  }
};

/// When a camera's result is believed.
struct AcceptanceOptions {
  int min_inlier_tracks = 60;
  double min_inlier_fraction = 0.25;
  double held_out_share = 0.15;
  double max_rotation_change_deg = 6.0;
  double max_translation_change_m = 0.6;
  double weak_translation_m = 0.03;
  double weak_rotation_deg = 0.15;
  void Visit(OptionVisitor& v) {
    v.Field("min_inlier_tracks", &min_inlier_tracks, {5, 1000000}, "least number of inlier tracks");
    v.Field("min_inlier_fraction", &min_inlier_fraction, {0.0, 1.0},
            "least share of associated tracks that agree with the result");
    v.Field("held_out_share", &held_out_share, {0.02, 0.5},
            "share of the tracks that only judge the result");
    v.Field("max_rotation_change_deg", &max_rotation_change_deg, {0.1, 180.0},
            "largest believable change of the rotation");
    v.Field("max_translation_change_m", &max_translation_change_m, {0.01, 10.0},
            "largest believable change of the translation");
    v.Field("weak_translation_m", &weak_translation_m, {0.001, 10.0},
            "a direction with a larger standard deviation is named as weakly observable");
    v.Field("weak_rotation_deg", &weak_rotation_deg, {0.001, 180.0},
            "an axis with a larger standard deviation is named as weakly observable");
  }
};

/// Everything that steers association and calibration.
struct CalibrationOptions {
  bool hold_intrinsics = false;
  bool estimate_time_offset = false;
  bool estimate_distortion = false;
  int seed = 1;
  AssociationOptions association;
  TermOptions terms;
  TrackRansacOptions ransac;
  CoarseToFineOptions coarse_to_fine;
  JointOptions joint;
  MapGuidedOptions map_guided;
  CrossCameraOptions cross_camera;
  PriorOptions prior;
  AcceptanceOptions acceptance;
  void Visit(OptionVisitor& v) {
    v.Field("hold_intrinsics", &hold_intrinsics, "keep s_f and u_0 at their initial values");
    v.Field("estimate_time_offset", &estimate_time_offset,
            "refine each camera's time offset to the lidar clock");
    v.Field("estimate_distortion", &estimate_distortion,
            "refine the first radial coefficient of each lens (k1; k3 of ftheta)");
    v.Field("seed", &seed, {0, 2147483647}, "seed of every random choice");
    v.Group("association", &association);
    v.Group("terms", &terms);
    v.Group("ransac", &ransac);
    v.Group("coarse_to_fine", &coarse_to_fine);
    v.Group("joint", &joint);
    v.Group("map_guided", &map_guided);
    v.Group("cross_camera", &cross_camera);
    v.Group("prior", &prior);
    v.Group("acceptance", &acceptance);
  }
};

}  // namespace scenecalib
