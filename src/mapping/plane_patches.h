#pragma once

#include <Eigen/Core>
#include <vector>

#include "pose_table.h"
#include "scenecalib/mapping/laser_correction.h"
#include "scenecalib/mapping/packed_scan.h"
#include "scenecalib/mapping/trajectory_refiner.h"

namespace scenecalib {

/// The points of one patch within a short time, as sums over points of products of
/// a = (1, u, v) and d, where u and v are the point's coordinates in the patch's plane and d its
/// distance to it: all that a point-to-plane solver needs of them.
struct PatchObservation {
  double seconds = 0.0;  ///< mean time since the trajectory's start
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();  ///< sum of a a^T
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();     ///< sum of a d
  double weight = 0.0;                                    ///< 1 / m^2, robust
  /// Which lasers saw them (where that is asked for): mean over the points.
  LaserCorrection::Place lasers;
  double count() const { return information(0, 0); }
};

/// A locally planar piece of the scene seen at several times.
struct PlanePatch {
  Eigen::Vector3d center_m = Eigen::Vector3d::Zero();
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();  ///< columns: u, v, normal; right-handed
  double sigma_m = 0.0;                                ///< RMS distance of its points
  std::vector<PatchObservation> observations;          ///< by time
};

/// Finds planar patches in an octree over all points, placed by the trajectory; coarse cells are
/// split where one plane is not enough. Weights are robust and account for each patch's thickness
/// and, with the estimated `unevenness`, for what more points of the same patch cannot average out.
/// Points are placed as `lasers` corrects them; `by_laser` sums the points of different lasers into
/// different observations. In a fixed order, whatever the number of threads.
std::vector<PlanePatch> FindPlanePatches(const std::vector<const PackedScan*>& scans,
                                         const LaserCorrection& lasers, bool by_laser,
                                         const PoseTable& map_from_lidar,
                                         const RefinementOptions& options);

/// Median thickness over patches.
double MedianThickness(const std::vector<PlanePatch>& patches);

}  // namespace scenecalib
