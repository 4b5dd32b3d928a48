#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/geometry/trajectory.h"
#include "scenecalib/sensor/measurements.h"

namespace scenecalib {

/// A drive through a world of boxes with everything known exactly: analytic ray casting, each
/// point at its own time, IMU by numeric differentiation of the motion.
struct SyntheticDrive {
  using Box = std::pair<Eigen::Vector3d, Eigen::Vector3d>;  ///< min, max corner

  static constexpr Timestamp kStartNs = 1700000000000000000;
  double speed_m_s = 6.0;
  double range_sigma_m = 0.01;
  double lidar_height_m = 2.0;
  int num_rings = 24;
  int num_columns = 360;
  double ring_range_m = 0.0;  ///< what every second ring measures too far, the others too near
  double ring_elevation_rad = 0.0;  ///< likewise, true less reported
  bool motion_compensated = false;  ///< every point at the stamp
  double loop_radius_m = 0.0;       ///< round and round a circle to the left; 0: along a street
  std::vector<Box> boxes = Street();
  Rigid3 lidar_from_imu{ExpSo3({0.02, -0.01, 0.1}), {-0.5, 0.1, -1.0}};
  Rigid3 lidar_from_body{ExpSo3({0.0, 0.01, -0.02}), {-1.2, 0.05, -1.8}};
  double odometry_scale_error = 0.01;
  Eigen::Vector3d gyroscope_bias_rad_s{0.004, -0.006, 0.008};
  Eigen::Vector3d accelerometer_bias_m_s2{0.03, -0.02, 0.04};

  /// Pose of the lidar in a world with z up and the ground at z = 0.
  Rigid3 WorldFromLidar(double t) const {
    if (loop_radius_m <= 0.0) return AlongStreet(t);
    const double turn = speed_m_s * t / loop_radius_m;
    const Eigen::Quaterniond yaw = ExpSo3({0.0, 0.0, turn});
    const Rigid3 sway(ExpSo3({0.01 * std::sin(4.0 * t), 0.015 * std::cos(3.0 * t), 0.0}),
                      {0.0, 0.0, lidar_height_m + 0.03 * std::sin(5.0 * t)});
    const Eigen::Vector3d center(0.0, loop_radius_m, 0.0);
    return Rigid3(yaw, center + yaw * Eigen::Vector3d(0.0, -loop_radius_m, 0.0)) * sway;
  }
  Rigid3 AlongStreet(double t) const {
    const Eigen::Vector3d position(speed_m_s * t, 0.3 * std::sin(0.9 * t),
                                   lidar_height_m + 0.03 * std::sin(5.0 * t));
    const double scale = speed_m_s > 0.0 ? 1.0 : 0.0;
    return {ExpSo3(scale * Eigen::Vector3d(0.01 * std::sin(4.0 * t), 0.015 * std::cos(3.0 * t),
                                           0.08 * std::sin(0.9 * t))),
            position};
  }
  Timestamp StampAt(double t) const { return AddSeconds(kStartNs, t); }

  /// Facades with bays, whose sides tell the motion along the street.
  static std::vector<Box> Street() {
    std::vector<Box> boxes;
    for (int i = -6; i < 14; ++i) {
      const double x = 7.0 * i;
      for (const double side : {-1.0, 1.0}) {
        const double front = 7.0 + 0.4 * ((i * i) % 3);
        const double y0 = side > 0.0 ? front : -front - 4.0;
        boxes.push_back({{x, y0, -1.0}, {x + 4.5, y0 + 4.0, 9.0}});
        boxes.push_back({{x - 2.5, side * 12.0 - 1.0, -1.0}, {x, side * 12.0 + 1.0, 7.0}});
      }
    }
    return boxes;
  }

  /// Walls and a ceiling without any end or feature: nothing tells the motion along it.
  static std::vector<Box> Tunnel() {
    return {{{-1e4, 4.0, -1.0}, {1e4, 5.0, 6.0}},
            {{-1e4, -5.0, -1.0}, {1e4, -4.0, 6.0}},
            {{-1e4, -5.0, 5.0}, {1e4, 5.0, 6.0}}};
  }

  /// Houses around a loop of that radius: one block inside, a ring of houses outside.
  static std::vector<Box> Ring(double radius_m) {
    const Eigen::Vector3d center(0.0, radius_m, 0.0);
    std::vector<Box> boxes;
    const double inner_m = 0.5 * radius_m;
    boxes.push_back({center + Eigen::Vector3d(-inner_m, -inner_m, -1.0),
                     center + Eigen::Vector3d(inner_m, inner_m, 9.0)});
    const int count = static_cast<int>(radius_m);
    for (int i = 0; i < count; ++i) {
      const double angle = 2.0 * 3.14159265 * i / count;
      const double away_m = radius_m + 9.0 + (i * i) % 3;
      const Eigen::Vector3d middle =
          center + away_m * Eigen::Vector3d(std::cos(angle), std::sin(angle), 0.0);
      boxes.push_back({middle + Eigen::Vector3d(-2.0, -2.0, -1.0),
                       middle + Eigen::Vector3d(2.0, 2.0, 5.0 + i % 4)});
    }
    return boxes;
  }

  /// Distance to the first surface, infinite for the sky.
  double Cast(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const {
    double nearest =
        direction.z() < 0.0 ? -origin.z() / direction.z() : std::numeric_limits<double>::infinity();
    for (const auto& [low, high] : boxes) {
      const Eigen::Array3d a = (low - origin).array() / direction.array();
      const Eigen::Array3d b = (high - origin).array() / direction.array();
      const double enter = a.min(b).maxCoeff();
      if (enter > 0.0 && enter < a.max(b).minCoeff()) nearest = std::min(nearest, enter);
    }
    return nearest;
  }

  /// The sweep that begins at t, stamped with its beginning.
  LidarScan Scan(double t, Random* random) const {
    constexpr double kPeriodS = 0.1;
    LidarScan scan;
    scan.stamp_ns = StampAt(t);
    for (int column = 0; column < num_columns; ++column) {
      const double share = column / static_cast<double>(num_columns);
      const double offset_s = motion_compensated ? 0.0 : kPeriodS * share;
      const Rigid3 world_from_lidar = WorldFromLidar(t + offset_s);
      for (int ring = 0; ring < num_rings; ++ring) {
        const double azimuth = 3.14159 - 6.283185 * share;
        const double elevation = -0.4 + 0.65 * ring / num_rings;
        const auto ray_at = [azimuth](double angle) {
          return Eigen::Vector3d(std::cos(angle) * std::cos(azimuth),
                                 std::cos(angle) * std::sin(azimuth), std::sin(angle));
        };
        const double sign = ring % 2 == 0 ? 1.0 : -1.0;
        const Eigen::Vector3d ray = ray_at(elevation);
        const double range_m =
            Cast(world_from_lidar.translation,
                 world_from_lidar.rotation * ray_at(elevation + sign * ring_elevation_rad)) +
            sign * ring_range_m + range_sigma_m * random->Gaussian();
        if (!(range_m < 60.0)) continue;
        LidarPoint point;
        point.position_in_lidar_m = (range_m * ray).cast<float>();
        point.time_offset_s = static_cast<float>(offset_s);
        point.ring = static_cast<std::uint16_t>(ring);
        scan.points.push_back(point);
      }
    }
    return scan;
  }

  std::vector<LidarScan> Scans(int count, std::uint64_t seed) const {
    Random random(seed);
    std::vector<LidarScan> scans;
    for (int i = 0; i < count; ++i) scans.push_back(Scan(0.1 * i, &random));
    return scans;
  }

  std::vector<ImuSample> Imu(double duration_s, double rate_hz, std::uint64_t seed) const {
    constexpr double kStepS = 1e-3;
    Random random(seed);
    const auto noise = [&random](double sigma) {
      const double x = random.Gaussian(), y = random.Gaussian(), z = random.Gaussian();
      return Eigen::Vector3d(sigma * Eigen::Vector3d(x, y, z));
    };
    std::vector<ImuSample> samples;
    for (int i = 0; i <= static_cast<int>(duration_s * rate_hz); ++i) {
      const double t = i / rate_hz;
      const Rigid3 before = WorldFromLidar(t - kStepS) * lidar_from_imu;
      const Rigid3 now = WorldFromLidar(t) * lidar_from_imu;
      const Rigid3 after = WorldFromLidar(t + kStepS) * lidar_from_imu;
      const Eigen::Vector3d acceleration =
          (after.translation - 2.0 * now.translation + before.translation) / (kStepS * kStepS);
      ImuSample sample;
      sample.stamp_ns = StampAt(t);
      sample.angular_velocity_rad_s =
          LogSo3(before.rotation.conjugate() * after.rotation) / (2.0 * kStepS) +
          gyroscope_bias_rad_s + noise(0.002);
      sample.linear_acceleration_m_s2 =
          now.rotation.conjugate() * (acceleration + Eigen::Vector3d(0.0, 0.0, 9.81)) +
          accelerometer_bias_m_s2 + noise(0.03);
      samples.push_back(sample);
    }
    return samples;
  }

  /// Dead reckoning at 50 Hz: every way too long by odometry_scale_error, noise on every step.
  std::vector<OdometrySample> Odometry(double duration_s, std::uint64_t seed) const {
    constexpr double kRateHz = 50.0;
    constexpr double kNoiseM = 0.001;
    Random random(seed);
    std::vector<OdometrySample> samples = {{StampAt(0.0), Rigid3()}};
    for (int i = 1; i <= static_cast<int>(duration_s * kRateHz); ++i) {
      Rigid3 step = (WorldFromLidar((i - 1) / kRateHz) * lidar_from_body).Inverse() *
                    (WorldFromLidar(i / kRateHz) * lidar_from_body);
      step.translation *= 1.0 + odometry_scale_error;
      for (int axis = 0; axis < 3; ++axis) step.translation[axis] += kNoiseM * random.Gaussian();
      samples.push_back({StampAt(i / kRateHz), samples.back().odom_from_body * step});
    }
    return samples;
  }

  Trajectory Truth(double duration_s) const {
    std::vector<TimedPose> poses;
    for (int i = 0; i <= static_cast<int>(duration_s / 0.005); ++i) {
      poses.push_back({StampAt(0.005 * i), WorldFromLidar(0.005 * i)});
    }
    return *Trajectory::Create(std::move(poses));
  }
};

/// RMS error of the relative motion over a window, in metres and radians.
inline Eigen::Vector2d RelativeMotionError(const Trajectory& estimated, const Trajectory& truth,
                                           double window_s) {
  Eigen::Vector2d squares = Eigen::Vector2d::Zero();
  int count = 0;
  const Timestamp start_ns = std::max(estimated.start_ns(), truth.start_ns());
  const Timestamp end_ns = std::min(estimated.end_ns(), truth.end_ns());
  for (Timestamp t = start_ns; AddSeconds(t, window_s) <= end_ns; t = AddSeconds(t, 0.02)) {
    const Timestamp u = AddSeconds(t, window_s);
    const Rigid3 a = estimated.Interpolate(t)->Inverse() * *estimated.Interpolate(u);
    const Rigid3 b = truth.Interpolate(t)->Inverse() * *truth.Interpolate(u);
    const Rigid3 difference = b.Inverse() * a;
    squares[0] += difference.translation.squaredNorm();
    squares[1] += std::pow(RotationAngle(a.rotation, b.rotation), 2);
    ++count;
  }
  return (squares / count).cwiseSqrt();
}

}  // namespace scenecalib
