#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "scenecalib/base/random.h"

namespace scenecalib {

/// A plane through points, with the spread of its inliers.
struct PlaneFit {
  Eigen::Vector3f center_m = Eigen::Vector3f::Zero();  ///< mean of the inliers
  Eigen::Vector3f normal = Eigen::Vector3f::UnitZ();   ///< unit, of either sign
  Eigen::Vector3f axis_u = Eigen::Vector3f::UnitX();   ///< in the plane, of largest extent
  Eigen::Vector3f axis_v = Eigen::Vector3f::UnitY();   ///< in the plane, of smallest extent
  float thickness_m = 0.0F;                            ///< RMS distance of the inliers
  float spread_v_m = 0.0F;                             ///< RMS extent of the inliers along axis_v
  int num_inliers = 0;

  float Distance(const Eigen::Vector3f& point_m) const { return normal.dot(point_m - center_m); }
};

/// The plane that most of the points agree with to within inlier_distance_m (RANSAC on at most a
/// few hundred of them), refined by principal components over all its inliers. None when fewer than
/// min_inliers agree or they lie on a line.
std::optional<PlaneFit> FitPlane(const std::vector<Eigen::Vector3f>& points,
                                 float inlier_distance_m, int min_inliers, Random random);

/// Principal components of all points; none for fewer than three.
std::optional<PlaneFit> FitPlaneToAll(const std::vector<Eigen::Vector3f>& points);

}  // namespace scenecalib
