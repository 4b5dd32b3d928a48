#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <vector>

#include "mapping/synthetic_drive.h"
#include "scenecalib/base/random.h"
#include "scenecalib/mapping/lidar_odometry.h"

namespace scenecalib::testing {

/// Distance from a point along a unit direction to the first surface; infinite for the sky.
using Scene =
    std::function<double(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction)>;
/// scene_from_lidar at a time in seconds.
using Motion = std::function<Rigid3(double)>;

inline Scene BoxStreet() {
  const SyntheticDrive drive;
  return [drive](const Eigen::Vector3d& o, const Eigen::Vector3d& d) { return drive.Cast(o, d); };
}

/// A smooth tunnel along x, 9 m wide and 6 m high: nothing tells how far one has driven.
inline Scene SmoothTunnel() {
  return [](const Eigen::Vector3d& o, const Eigen::Vector3d& d) {
    const double side = (std::copysign(4.5, d.y()) - o.y()) / d.y();
    const double level = ((d.z() > 0.0 ? 6.0 : 0.0) - o.z()) / d.z();
    return std::min(side, level);
  };
}

/// Nothing but flat ground.
inline Scene OpenField() {
  return [](const Eigen::Vector3d& o, const Eigen::Vector3d& d) {
    return d.z() < 0.0 ? -o.z() / d.z() : std::numeric_limits<double>::infinity();
  };
}

inline Motion StraightAt(double speed_m_s) {
  return [speed_m_s](double t) {
    return Rigid3(Eigen::Quaterniond::Identity(), {speed_m_s * t, 0.0, 2.0});
  };
}

/// A spinning lidar for odometry tests.
struct SceneLidar {
  int num_rings = 24;
  int num_columns = 360;
  double range_sigma_m = 0.01;
  double period_s = 0.1;
  double max_range_m = 80.0;
  double stamp_share = 0.0;       ///< where in the sweep the stamp is: 0 first, 1 last point
  double empty_from_share = 2.0;  ///< from this share of the turn on nothing comes back
  Rigid3 body_from_lidar;         ///< Motion moves the body

  LidarScan Sweep(const Scene& scene, const Motion& scene_from_body, double start_s,
                  Random* random) const {
    LidarScan scan;
    const double stamp_s = start_s + stamp_share * period_s;
    scan.stamp_ns = AddSeconds(SyntheticDrive::kStartNs, stamp_s);
    for (int column = 0; column < num_columns; ++column) {
      const double share = column / static_cast<double>(num_columns);
      const double time_s = start_s + period_s * share;
      const Rigid3 scene_from_lidar = scene_from_body(time_s) * body_from_lidar;
      for (int ring = 0; ring < num_rings; ++ring) {
        const double azimuth = M_PI * (1.0 - 2.0 * share);
        const double elevation = -0.4 + 0.65 * ring / num_rings;
        const Eigen::Vector3d ray(std::cos(elevation) * std::cos(azimuth),
                                  std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
        const double range_m =
            scene(scene_from_lidar.translation, scene_from_lidar.rotation * ray) +
            range_sigma_m * random->Gaussian();
        if (!(range_m < max_range_m) || share >= empty_from_share) continue;
        LidarPoint point;
        point.position_in_lidar_m = (range_m * ray).cast<float>();
        point.time_offset_s = static_cast<float>(time_s - stamp_s);
        point.ring = static_cast<std::uint16_t>(ring);
        scan.points.push_back(point);
      }
    }
    return scan;
  }
};

struct OdometryRun {
  std::vector<SweepRegistration> sweeps;
  Motion scene_from_lidar;

  /// Error of the motion between the middles of two sweeps.
  Rigid3 ErrorBetween(std::size_t from, std::size_t to) const {
    const auto truth = [this](std::size_t i) {
      return scene_from_lidar(SecondsBetween(SyntheticDrive::kStartNs, sweeps[i].mid_ns()));
    };
    const Rigid3 true_motion = truth(from).Inverse() * truth(to);
    const Rigid3 motion = sweeps[from].map_from_lidar.Inverse() * sweeps[to].map_from_lidar;
    return true_motion.Inverse() * motion;
  }
  double WorstTranslation_m() const {
    double worst_m = 0.0;
    for (std::size_t i = 1; i < sweeps.size(); ++i) {
      worst_m = std::max(worst_m, ErrorBetween(0, i).translation.norm());
    }
    return worst_m;
  }
  double WorstRotation_rad() const {
    double worst_rad = 0.0;
    for (std::size_t i = 1; i < sweeps.size(); ++i) {
      worst_rad = std::max(
          worst_rad, RotationAngle(ErrorBetween(0, i).rotation, Eigen::Quaterniond::Identity()));
    }
    return worst_rad;
  }
  bool AllConverged() const {
    return std::all_of(sweeps.begin(), sweeps.end(),
                       [](const SweepRegistration& s) { return s.converged; });
  }
};

/// Scans that are refused are left out.
inline OdometryRun RunOdometry(const Scene& scene, const Motion& scene_from_body, int num_scans,
                               const SceneLidar& lidar = {},
                               const MotionPrior& prior = MotionPrior{Rig{}}) {
  OdometryRun run;
  run.scene_from_lidar = [scene_from_body, lidar](double t) {
    return scene_from_body(t) * lidar.body_from_lidar;
  };
  LidarOdometry odometry{OdometryOptions{}};
  Random random(17);
  for (int i = 0; i < num_scans; ++i) {
    const auto sweep =
        odometry.Register(lidar.Sweep(scene, scene_from_body, lidar.period_s * i, &random), prior);
    if (sweep.ok()) run.sweeps.push_back(*sweep);
  }
  return run;
}

/// Odometry samples along a motion whose lengths are misjudged by a share.
inline MotionPrior WithOdometry(const Motion& scene_from_body, double duration_s,
                                double scale_error) {
  Rig rig;
  rig.odometry = OdometryConfig{"/odometry", Rigid3()};
  MotionPrior prior(rig);
  for (double t = -0.1; t < duration_s; t += 0.02) {
    Rigid3 pose = scene_from_body(t);
    pose.translation *= 1.0 + scale_error;
    prior.AddOdometry({AddSeconds(SyntheticDrive::kStartNs, t), pose});
  }
  return prior;
}

}  // namespace scenecalib::testing
