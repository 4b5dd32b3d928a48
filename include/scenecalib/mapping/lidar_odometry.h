#pragma once

#include <memory>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/base/status.h"
#include "scenecalib/geometry/trajectory.h"
#include "scenecalib/mapping/motion_prior.h"
#include "scenecalib/mapping/voxel_plane_map.h"
#include "scenecalib/sensor/measurements.h"

namespace scenecalib {

/// Scan-to-map registration.
struct OdometryOptions {
  double min_range_m = 3.0;
  double max_range_m = 120.0;
  double finest_voxel_size_m = 0.5;
  double source_voxel_size_m = 0.6;
  double map_voxel_size_m = 0.2;
  int min_points = 200;
  int max_iterations = 40;
  double max_residual_m = 0.6;
  double min_inlier_ratio = 0.4;
  int max_lost_scans = 5;
  void Visit(OptionVisitor& v) {
    v.Field("min_range_m", &min_range_m, {0.0, 20.0},
            "closer returns are the vehicle itself and are dropped");
    v.Field("max_range_m", &max_range_m, {5.0, 1000.0}, "farther returns are dropped");
    v.Field("finest_voxel_size_m", &finest_voxel_size_m, {0.05, 5.0},
            "smallest voxel of the local map; two more levels double it");
    v.Field("source_voxel_size_m", &source_voxel_size_m, {0.05, 5.0},
            "one point per voxel of this edge is registered");
    v.Field("map_voxel_size_m", &map_voxel_size_m, {0.02, 2.0},
            "one point per scan and voxel of this edge enters the local map");
    v.Field("min_points", &min_points, {20, 1000000}, "a scan with fewer points is refused");
    v.Field("max_iterations", &max_iterations, {5, 500}, "of the registration of a scan");
    v.Field("max_residual_m", &max_residual_m, {0.05, 5.0},
            "distance to the plane at which the first iterations ignore a point");
    v.Field("min_inlier_ratio", &min_inlier_ratio, {0.05, 1.0},
            "share of matched points that must fit, or else tracking is lost");
    v.Field("max_lost_scans", &max_lost_scans, {1, 1000},
            "after so many lost scans in a row the local map is started anew");
  }
};

/// A scan placed in the odometry's map, with the motion during its sweep.
struct SweepRegistration {
  Timestamp stamp_ns = 0;
  Timestamp first_point_ns = 0;
  Timestamp last_point_ns = 0;
  Rigid3 map_from_lidar;  ///< at the middle of the sweep
  /// map_from_lidar over [first_point_ns, last_point_ns], every 10 ms or denser.
  std::vector<TimedPose> poses;
  bool converged = false;  ///< false: tracking was lost, the pose is a prediction
  int iterations = 0;
  int num_inliers = 0;
  double rms_m = 0.0;  ///< point-to-plane distance of the inliers
  int stretch = 0;     ///< counts restarts of the local map; poses are comparable within one
  bool used_gyroscope = false;
  bool used_odometry = false;

  Timestamp mid_ns() const { return first_point_ns + (last_point_ns - first_point_ns) / 2; }
};

/// Lidar odometry: deskew to the middle of the sweep, point-to-plane Gauss-Newton against a voxel
/// map of planes, with rotation predicted by the gyroscope, translation by the odometry, and each
/// by constant velocity (re-estimated from the registration itself) where there is none.
/// Differs from the paper, which uses plain ICP: deskewing to the sweep's middle rather than to its
/// end took the trajectory error from 5 cm to 0.3 cm on a synthetic street.
class LidarOdometry {
 public:
  explicit LidarOdometry(const OdometryOptions& options);

  /// InvalidArgument for a stamp that does not increase or too few points within range.
  Result<SweepRegistration> Register(const LidarScan& scan, const MotionPrior& prior);

  void Reset();

 private:
  struct Alignment {
    Rigid3 map_from_lidar;
    bool converged = false;
    int iterations = 0;
    int num_matched = 0;
    int num_inliers = 0;
    double rms_m = 0.0;
  };
  struct Sweep;

  Sweep Prepare(const LidarScan& scan) const;
  void Deskew(const MotionPrior& prior, Sweep* sweep) const;
  Rigid3 Predict(const Sweep& sweep, const MotionPrior& prior) const;
  Alignment Align(const std::vector<Eigen::Vector3d>& points_in_lidar, const Rigid3& predicted,
                  double first_residual_m) const;
  Alignment AlignWithVelocity(const MotionPrior& prior, Sweep* sweep);
  Alignment Bootstrap(const MotionPrior& prior, Sweep* sweep);
  bool IsLost(const Alignment& alignment, std::size_t num_source) const;
  void InsertIntoMap(const Sweep& sweep, const Rigid3& map_from_lidar);
  void UpdateVelocity(const Rigid3& map_from_lidar, Timestamp mid_ns);
  SweepRegistration Finish(const Sweep& sweep, const Alignment& alignment) const;

  OdometryOptions options_;
  VoxelPlaneMap map_;
  std::shared_ptr<Sweep> first_sweep_;  ///< kept until the second scan told the velocity
  Rigid3 map_from_last_;
  Timestamp last_stamp_ns_ = 0;
  Timestamp last_mid_ns_ = 0;
  Eigen::Vector3d velocity_in_lidar_m_s_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_velocity_rad_s_ = Eigen::Vector3d::Zero();
  int num_registered_ = 0;  ///< in this stretch
  int num_lost_in_a_row_ = 0;
  int stretch_ = 0;
};

/// Up direction in the lidar frame from the ground around the vehicle; the lidar's own z where no
/// ground is seen.
Eigen::Vector3d EstimateUpFromGround(const std::vector<Eigen::Vector3d>& points_in_lidar);

}  // namespace scenecalib
