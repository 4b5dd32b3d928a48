#include "camera_checks.h"

#include <cmath>
#include <sstream>

namespace scenecalib {

double Theta(const Eigen::Vector3d& ray) { return std::atan2(ray.head<2>().norm(), ray.z()); }

std::array<Eigen::Vector2d, 4> Corners(const CameraIntrinsics& intrinsics) {
  const double right = intrinsics.width_px - 0.5;
  const double bottom = intrinsics.height_px - 0.5;
  const Eigen::Vector2d& center = intrinsics.principal_point_px;
  return {Eigen::Vector2d(-0.5, -0.5) - center, Eigen::Vector2d(right, -0.5) - center,
          Eigen::Vector2d(-0.5, bottom) - center, Eigen::Vector2d(right, bottom) - center};
}

Eigen::Vector2d FarthestCorner(const CameraIntrinsics& intrinsics) {
  Eigen::Vector2d farthest = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& corner : Corners(intrinsics)) {
    if (corner.norm() > farthest.norm()) farthest = corner;
  }
  return farthest;
}

Status CheckCount(const std::string& model, const std::string& key,
                  const std::vector<double>& values, std::size_t count) {
  if (values.size() != count) {
    return Status::InvalidArgument(model + ": " + key + " has " + std::to_string(values.size()) +
                                   " numbers, must have " + std::to_string(count));
  }
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (std::isfinite(values[i])) continue;
    return Status::InvalidArgument(model + ": " + key + "[" + std::to_string(i) + "] is " +
                                   std::to_string(values[i]) + ", must be finite");
  }
  return Status::Ok();
}

Status CheckPositive(const std::string& model, const std::string& key, double value) {
  if (value > 0.0) return Status::Ok();
  std::ostringstream message;
  message << model << ": " << key << " is " << value << ", must be positive";
  return Status::InvalidArgument(message.str());
}

Status CheckFocal(const CameraIntrinsics& intrinsics) {
  SCENECALIB_RETURN_IF_ERROR(CheckCount(intrinsics.model, "focal_px", intrinsics.focal_px, 2));
  SCENECALIB_RETURN_IF_ERROR(
      CheckPositive(intrinsics.model, "focal_px[0]", intrinsics.focal_px[0]));
  return CheckPositive(intrinsics.model, "focal_px[1]", intrinsics.focal_px[1]);
}

Status NotMonotonic(const std::string& model, const std::string& key, double theta_rad,
                    double radius_px, double corner_px) {
  std::ostringstream message;
  message << model << ": " << key << " stops being monotonic at " << theta_rad * 180.0 / kPi
          << " deg, " << radius_px << " px from the principal point, which is inside the image "
          << "(farthest corner: " << corner_px << " px)";
  return Status::InvalidArgument(message.str());
}

}  // namespace scenecalib
