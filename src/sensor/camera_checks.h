#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/sensor/camera_model.h"

namespace scenecalib {

constexpr double kPi = 3.14159265358979323846;

/// Angle of a ray to the optical axis, radians in [0, pi].
double Theta(const Eigen::Vector3d& ray);

/// The image's four corners (of its extent, not of its pixels' centres) minus the principal point.
std::array<Eigen::Vector2d, 4> Corners(const CameraIntrinsics& intrinsics);
/// The longest of them.
Eigen::Vector2d FarthestCorner(const CameraIntrinsics& intrinsics);

/// InvalidArgument unless the list has `count` finite numbers.
Status CheckCount(const std::string& model, const std::string& key,
                  const std::vector<double>& values, std::size_t count);
Status CheckPositive(const std::string& model, const std::string& key, double value);
/// focal_px is two positive numbers.
Status CheckFocal(const CameraIntrinsics& intrinsics);

/// The refusal of a model that folds inside the image: angle and radius at which it does, and the
/// radius of the farthest corner.
Status NotMonotonic(const std::string& model, const std::string& key, double theta_rad,
                    double radius_px, double corner_px);

}  // namespace scenecalib
