#pragma once

#include <Eigen/Core>
#include <vector>

#include "scenecalib/mapping/voxel_plane_map.h"
#include "sweep_motion.h"

namespace scenecalib {

struct AlignmentOptions {
  int max_iterations = 40;
  double finest_voxel_size_m = 0.5;
  double first_kernel_m = 0.2;  ///< scale of the robust kernel in the first iteration
  /// False: the motion during the sweep is held.
  bool estimate_motion = true;
};

/// Outcome of SweepAlignment::Run.
struct AlignedSweep {
  Rigid3 map_from_lidar;  ///< at the middle of the sweep
  bool converged = false;
  int iterations = 0;
  int num_matched = 0;
  int num_inliers = 0;
  double rms_m = 0.0;  ///< of the inliers' distances
  /// Unit vectors along which the matched planes fix no translation, and about which no rotation.
  std::vector<Eigen::Vector3d> weak_translations_in_map;
  std::vector<Eigen::Vector3d> weak_rotations_in_map;
  /// Of the planes' information on the translation, trace at most 1: d^T m d is direction d's
  /// share.
  Eigen::Matrix3d translation_shares = Eigen::Matrix3d::Zero();
};

/// A point this near to its plane is an inlier.
constexpr double kInlierResidualM = 0.15;

/// Point-to-plane Gauss-Newton of a sweep against the map: pose in the middle and constant velocity
/// of the correction during the sweep together (twelve unknowns), with the expectation as a prior.
/// Directions that the planes leave open follow the expectation alone. Sums run over fixed chunks
/// in order, so the result does not depend on the number of threads.
AlignedSweep AlignSweep(const VoxelPlaneMap& map, const std::vector<SweepPoint>& points,
                        const MotionExpectation& expectation, const Rigid3& start,
                        const AlignmentOptions& options, SweepMotion* motion);

}  // namespace scenecalib
