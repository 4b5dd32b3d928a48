#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "image_pairs.h"

namespace scenecalib {

/// Differences beyond this many local contrasts are other things: cars, shadows, reflections.
constexpr double kMaxDifference = 0.5;
/// A camera's motion from its calibrated pose; one unit per axis is the largest perturbation.
using ScaledPose = Eigen::Matrix<double, kNumAxes, 1>;

/// For every camera the pose, within the perturbations' range, under which its pairs with other
/// cameras look most alike: the least sum of squared differences, cut off at kMaxDifference. One
/// camera's images at two times do not fix all six axes: there, and without pairs, it is zero.
std::vector<ScaledPose> FindBestPoses(const std::vector<Comparison>& comparisons,
                                      const std::vector<std::vector<std::size_t>>& pairs_of_camera);

}  // namespace scenecalib
