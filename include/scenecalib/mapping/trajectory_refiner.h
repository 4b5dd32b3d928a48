#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/base/progress.h"
#include "scenecalib/base/status.h"
#include "scenecalib/mapping/laser_correction.h"
#include "scenecalib/mapping/motion_prior.h"
#include "scenecalib/mapping/packed_scan.h"
#include "scenecalib/mapping/pose_spline.h"
#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

/// The batch refinement of a segment's trajectory in continuous time.
struct RefinementOptions {
  bool enabled = true;
  double knot_interval_s = 0.05;
  int max_rounds = 8;
  double finest_patch_m = 0.4;
  int num_patch_scales = 3;
  double max_curvature_m = 0.006;
  double max_thickness_m = 0.08;
  double min_patch_span_s = 0.25;
  double time_bin_s = 0.02;
  int max_points = 6000000;
  double max_jerk_m_s3 = 10.0;
  double max_angular_jerk_rad_s3 = 4.0;
  int max_solver_iterations = 150;
  double solver_tolerance = 1e-3;
  bool use_accelerometer = true;
  bool use_odometry = true;
  bool estimate_lasers = true;
  void Visit(OptionVisitor& v) {
    v.Field("enabled", &enabled, "false: the odometry's trajectory is used as it is");
    v.Field("knot_interval_s", &knot_interval_s, {0.01, 0.5}, "between knots of the pose spline");
    v.Field("max_rounds", &max_rounds, {1, 100}, "of associating points to planes and solving");
    v.Field("finest_patch_m", &finest_patch_m, {0.05, 5.0}, "edge of the smallest plane patch");
    v.Field("num_patch_scales", &num_patch_scales, {1, 5}, "patch sizes, each twice the last");
    v.Field("max_curvature_m", &max_curvature_m, {1e-4, 1.0},
            "a patch is split when one plane fits worse than its parts' planes by more (RMS)");
    v.Field("max_thickness_m", &max_thickness_m, {1e-3, 1.0}, "RMS at which a patch is no plane");
    v.Field("min_patch_span_s", &min_patch_span_s, {0.0, 100.0},
            "a patch seen over a shorter time says nothing on motion and may be a moving object");
    v.Field("time_bin_s", &time_bin_s, {1e-3, 1.0},
            "points of a patch within this time are summed into one observation");
    v.Field("max_points", &max_points, {10000, 1000000000},
            "above it scans are thinned evenly: bounds memory and time");
    v.Field("max_jerk_m_s3", &max_jerk_m_s3, {0.1, 1e6}, "sigma of the smoothness prior");
    v.Field("max_angular_jerk_rad_s3", &max_angular_jerk_rad_s3, {0.1, 1e6},
            "sigma of the smoothness prior");
    v.Field("max_solver_iterations", &max_solver_iterations, {1, 10000},
            "conjugate-gradient iterations of a round");
    v.Field("solver_tolerance", &solver_tolerance, {1e-12, 0.5},
            "relative residual at which the last rounds' linear solves stop");
    v.Field("use_accelerometer", &use_accelerometer, "false: only the gyroscope is used");
    v.Field("use_odometry", &use_odometry,
            "false: the odometry only predicts where the registration of a scan begins");
    v.Field("estimate_lasers", &estimate_lasers,
            "find what each laser's range and angles are off by, and correct its points; not done "
            "for motion-compensated scans");
  }
};

/// The refined trajectory with its evidence.
struct RefinementResult {
  PoseSpline map_from_lidar;
  int num_rounds = 0;
  bool converged = false;  ///< the last round moved the trajectory by less than its noise
  int num_patches = 0;
  int num_points = 0;               ///< on patches
  double thickness_before_m = 0.0;  ///< median over patches, with the trajectory given
  double thickness_after_m = 0.0;
  std::optional<Eigen::Vector3d> gyroscope_bias_rad_s;     ///< in the IMU frame
  std::optional<Eigen::Vector3d> accelerometer_bias_m_s2;  ///< in the IMU frame
  std::optional<Eigen::Vector3d> gravity_in_map_m_s2;      ///< about 9.81 downwards
  double gyroscope_sigma_rad_s = 0.0;                      ///< per axis, from the residuals
  double accelerometer_sigma_m_s2 = 0.0;                   ///< per axis, from the residuals
  std::optional<double> odometry_scale_error;  ///< odometry's way over the true way, less 1
  double odometry_sigma_m_s = 0.0;             ///< per axis, from the residuals
  /// Share of the time at which the lidar does not see the motion along some direction.
  double degenerate_share = 0.0;
  std::vector<RelativeMotionSigma> relative_motion;
  LaserCorrection lasers;  ///< empty if not estimated
};

/// Refines a trajectory in continuous time: every point counts at its own time, planes are shared
/// by all scans and solved with the trajectory, gyroscope (with bias) and accelerometer (with bias
/// and gravity) bear the short intervals, odometry's velocity (with a scale) what the lidar does
/// not see, and what each laser is off by is solved with them. The planes' parameters are
/// eliminated from each Gauss-Newton step (docs/math.md): alternating between planes and poses
/// instead takes hundreds of rounds for the smooth errors that matter most here.
///
/// `scans` lie within the initial spline's time. The relative-motion sigma compares the solutions
/// of two halves of the data, so that it sees what a formal covariance does not. Deterministic for
/// any number of threads. InsufficientData when the scene offers no planes. Cancelled on request.
Result<RefinementResult> RefineTrajectory(const PoseSpline& initial,
                                          const std::vector<const PackedScan*>& scans,
                                          const MotionPrior& prior,
                                          const RefinementOptions& options,
                                          const ProgressCallback& progress);

/// What each laser is off by where the trajectory is known: the same terms as RefineTrajectory's
/// with the poses held. `scans` lie within the trajectory's time. Nothing is corrected where lasers
/// do not tell apart. InsufficientData when the scene offers no planes.
Result<LaserCorrection> EstimateLasers(const Trajectory& map_from_lidar,
                                       const std::vector<const PackedScan*>& scans,
                                       const RefinementOptions& options);

/// RMS differences of the two trajectories' motions within 0.1, 0.5, 1 and 4 s, as far as they are
/// long enough. `map_from_lidar` covers the other's time.
std::vector<RelativeMotionSigma> RelativeMotionDifference(const Trajectory& map_from_lidar,
                                                          const PoseSpline& other);

}  // namespace scenecalib
