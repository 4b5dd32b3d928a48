#pragma once

#include <string>

#include "scenecalib/base/options.h"

namespace scenecalib {

/// What the street looks like. Everything is drawn from SimulationOptions::seed.
struct SimulatedWorldOptions {
  std::string kind = "street";
  int num_moving_cars = 3;
  bool shadows = true;

  void Visit(OptionVisitor& v) {
    v.Field(
        "kind", &kind,
        "street (a canyon of facades), suburb (detached houses, gardens, hedges), plaza (a wide "
        "paved space with kiosks and columns), industrial (yards, containers, fences, large "
        "plain halls), avenue (rows of high trees, parked cars, houses far back) or village (a "
        "narrow road between low houses and stone walls)");
    v.Field("num_moving_cars", &num_moving_cars, {0, 20},
            "other cars that drive, with and against");
    v.Field("shadows", &shadows, "the sun casts shadows (costs a second ray per pixel)");
  }
};

/// How the vehicle drives.
struct SimulatedDriveOptions {
  std::string kind = "turns";
  double speed_m_s = 8.0;
  double speed_variation = 0.2;
  double suspension_deg = 0.5;
  double suspension_m = 0.015;

  void Visit(OptionVisitor& v) {
    v.Field("kind", &kind,
            "turns (right-angled corners and gentle curves), gentle (curves only) or straight");
    v.Field("speed_m_s", &speed_m_s, {0.5, 30.0}, "mean speed; corners are taken slower");
    v.Field("speed_variation", &speed_variation, {0.0, 0.6}, "share by which the speed changes");
    v.Field("suspension_deg", &suspension_deg, {0.0, 3.0},
            "amplitude of the body's pitch and roll on its springs (1-2 Hz)");
    v.Field("suspension_m", &suspension_m, {0.0, 0.1}, "amplitude of its heave");
  }
};

/// A spinning lidar.
struct SimulatedLidarOptions {
  int rings = 64;
  int columns = 1024;
  double rate_hz = 10.0;
  double lowest_ring_deg = -25.0;
  double highest_ring_deg = 15.0;
  double min_range_m = 0.5;
  double max_range_m = 120.0;
  double range_noise_m = 0.02;
  double ring_range_m = 0.0;
  double ring_angle_deg = 0.0;
  double beam_mrad = 0.0;
  double dropout = 0.01;
  double height_m = 1.9;

  void Visit(OptionVisitor& v) {
    v.Field("rings", &rings, {2, 256}, "lasers, evenly spaced in elevation; ring 0 is the lowest");
    v.Field("columns", &columns, {16, 8192}, "firings per turn");
    v.Field("rate_hz", &rate_hz, {0.5, 50.0}, "turns per second");
    v.Field("lowest_ring_deg", &lowest_ring_deg, {-89.0, 89.0}, "elevation of ring 0");
    v.Field("highest_ring_deg", &highest_ring_deg, {-89.0, 89.0}, "elevation of the last ring");
    v.Field("min_range_m", &min_range_m, {0.0, 10.0}, "nearer returns are not reported");
    v.Field("max_range_m", &max_range_m, {5.0, 500.0}, "farther returns are not reported");
    v.Field("range_noise_m", &range_noise_m, {0.0, 0.5}, "standard deviation along the ray");
    v.Field("ring_range_m", &ring_range_m, {0.0, 0.5},
            "deviation of what a laser always measures too far or too near");
    v.Field("ring_angle_deg", &ring_angle_deg, {0.0, 2.0},
            "deviation of a laser's elevation and azimuth from what the lidar reports");
    v.Field("beam_mrad", &beam_mrad, {0.0, 20.0},
            "the beam's divergence: what it meets at an edge is measured in between");
    v.Field("dropout", &dropout, {0.0, 0.9},
            "share of points lost at random; grazing and dark surfaces lose more");
    v.Field("height_m", &height_m, {0.3, 5.0}, "of the lidar above the road");
  }
};

/// An IMU that is rigidly mounted where the rig says.
struct SimulatedImuOptions {
  double rate_hz = 200.0;
  double gyro_noise_rad_s = 0.001;
  double gyro_bias_rad_s = 0.003;
  double gyro_walk_rad_s_sqrt_s = 0.00005;
  double acceleration_noise_m_s2 = 0.02;
  double acceleration_bias_m_s2 = 0.05;
  double acceleration_walk_m_s2_sqrt_s = 0.0005;

  void Visit(OptionVisitor& v) {
    v.Field("rate_hz", &rate_hz, {1.0, 2000.0}, "samples per second");
    v.Field("gyro_noise_rad_s", &gyro_noise_rad_s, {0.0, 1.0}, "white noise per sample");
    v.Field("gyro_bias_rad_s", &gyro_bias_rad_s, {0.0, 1.0}, "deviation of the constant bias");
    v.Field("gyro_walk_rad_s_sqrt_s", &gyro_walk_rad_s_sqrt_s, {0.0, 1.0},
            "walk of the bias, deviation after one second");
    v.Field("acceleration_noise_m_s2", &acceleration_noise_m_s2, {0.0, 10.0},
            "white noise per sample");
    v.Field("acceleration_bias_m_s2", &acceleration_bias_m_s2, {0.0, 10.0},
            "deviation of the constant bias");
    v.Field("acceleration_walk_m_s2_sqrt_s", &acceleration_walk_m_s2_sqrt_s, {0.0, 10.0},
            "walk of the bias, deviation after one second");
  }
};

/// Wheel odometry: dead reckoning that drifts.
struct SimulatedOdometryOptions {
  double rate_hz = 50.0;
  double scale_error = 0.01;
  double yaw_drift_deg_s = 0.1;
  double noise_m = 0.001;
  double noise_deg = 0.01;

  void Visit(OptionVisitor& v) {
    v.Field("rate_hz", &rate_hz, {1.0, 1000.0}, "samples per second");
    v.Field("scale_error", &scale_error, {0.0, 0.2}, "deviation of the share of length misjudged");
    v.Field("yaw_drift_deg_s", &yaw_drift_deg_s, {0.0, 10.0},
            "deviation of the constant yaw drift");
    v.Field("noise_m", &noise_m, {0.0, 0.5}, "deviation added to every increment");
    v.Field("noise_deg", &noise_deg, {0.0, 5.0}, "deviation added to every increment, per axis");
  }
};

/// What the cameras have in common; each draws its own exposure, gamma, vignetting and clock.
struct SimulatedCameraOptions {
  double rate_hz = 10.0;
  bool color = true;
  double noise_levels = 1.5;
  double exposure_spread = 0.25;
  double clock_rate_spread = 0.0002;
  double max_theta_deg = 100.0;
  int supersampling = 4;

  void Visit(OptionVisitor& v) {
    v.Field("rate_hz", &rate_hz, {0.1, 100.0}, "images per second and camera");
    v.Field("color", &color, "BGR images, otherwise grey ones");
    v.Field("noise_levels", &noise_levels, {0.0, 30.0}, "image noise, deviation in levels of 255");
    v.Field("exposure_spread", &exposure_spread, {0.0, 1.0},
            "largest difference of a camera's exposure to the middle, natural logarithm");
    v.Field("clock_rate_spread", &clock_rate_spread, {0.0, 0.05},
            "largest share by which a camera's frame rate is off");
    v.Field("max_theta_deg", &max_theta_deg, {10.0, 180.0},
            "the lenses' image circle: beyond this angle from the axis the image is black");
    v.Field("supersampling", &supersampling, {1, 16}, "rays per pixel at edges of objects");
  }
};

/// How far the written initial rig is from the truth: every component is off by between half of and
/// the whole figure, with random sign.
struct SimulatedStartOptions {
  double rotation_deg = 0.5;
  double translation_m = 0.05;
  double focal_share = 0.005;
  double principal_point_px = 4.0;
  double time_offset_s = 0.0;

  void Visit(OptionVisitor& v) {
    v.Field("rotation_deg", &rotation_deg, {0.0, 30.0}, "per axis of the camera frame");
    v.Field("translation_m", &translation_m, {0.0, 2.0}, "per axis of the camera frame");
    v.Field("focal_share", &focal_share, {0.0, 0.2}, "of the focal scale");
    v.Field("principal_point_px", &principal_point_px, {0.0, 100.0}, "per axis");
    v.Field("time_offset_s", &time_offset_s, {0.0, 1.0}, "of the camera's clock");
  }
};

/// Everything that decides a simulated recording, together with its rig.
struct SimulationOptions {
  int seed = 1;
  double duration_s = 10.0;
  SimulatedWorldOptions world;
  SimulatedDriveOptions drive;
  SimulatedLidarOptions lidar;
  SimulatedImuOptions imu;
  SimulatedOdometryOptions odometry;
  SimulatedCameraOptions camera;
  SimulatedStartOptions start;

  void Visit(OptionVisitor& v) {
    v.Field("seed", &seed, {0, 2147483647}, "of every random choice");
    v.Field("duration_s", &duration_s, {0.2, 600.0}, "of the recording");
    v.Group("world", &world);
    v.Group("drive", &drive);
    v.Group("lidar", &lidar);
    v.Group("imu", &imu);
    v.Group("odometry", &odometry);
    v.Group("camera", &camera);
    v.Group("start", &start);
  }
};

}  // namespace scenecalib
