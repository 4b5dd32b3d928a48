#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <vector>

namespace scenecalib {

/// One scene point seen in two images of the same camera, as unit rays in the camera frame with
/// their derivatives by the pixel: valid for any field of view.
struct RayPair {
  Eigen::Vector3d ray_in_first;
  Eigen::Vector3d ray_in_second;
  Eigen::Matrix<double, 3, 2> first_by_pixel;
  Eigen::Matrix<double, 3, 2> second_by_pixel;
};

/// Motion between two images up to scale: rays of the first, rotated by second_from_first and moved
/// along `direction`, meet the rays of the second.
struct RelativeMotion {
  Eigen::Quaterniond second_from_first = Eigen::Quaterniond::Identity();
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  ///< unit, in the second camera frame
  int num_inliers = 0;
  std::vector<bool> inlier;    ///< as the pairs
  double inlier_rms_px = 0.0;  ///< Sampson
};

struct RelativeMotionOptions {
  int num_samples = 200;
  double max_error_px = 0.7;
  std::uint64_t seed = 1;
};

/// Sampson distance in pixels of a pair from the epipolar constraint
///   ray_in_second . (direction x second_from_first ray_in_first) = 0.
double EpipolarErrorPx(const RayPair& pair, const RelativeMotion& motion);

/// Motion that most pairs agree with, by RANSAC over samples of six pairs. Each sample is solved by
/// Gauss-Newton on rotation and direction from a rotation that fits all pairs best, not by the
/// linear eight-point method, which fails when all points of a sample lie on one plane (a road, a
/// facade). Meant for neighbouring images of a vehicle's camera: beyond about 30 degrees between
/// the two, what the common rotation leaves may be too far to converge.
///
/// With a `guess`, say the motion between the images before, the samples are only drawn when what
/// Gauss-Newton makes of it explains fewer than three quarters of the pairs.
///
/// None with fewer than 12 pairs or when fewer than 12 agree. When the camera only rotated or stood
/// still every direction fits: then all pairs are inliers and `direction` means nothing.
std::optional<RelativeMotion> EstimateRelativeMotion(const std::vector<RayPair>& pairs,
                                                     const RelativeMotionOptions& options,
                                                     const RelativeMotion* guess = nullptr);

}  // namespace scenecalib
