#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <optional>

#include "scenecalib/mapping/lidar_odometry.h"

namespace scenecalib {
namespace {

struct Ground {
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  double num_points = 0.0;
};

/// The ground below the lidar when `sign` times its z axis points up.
std::optional<Ground> FindGround(const std::vector<Eigen::Vector3d>& points_in_lidar, double sign) {
  constexpr double kMaxRangeM = 20.0;
  constexpr double kMaxTiltRad = 0.35;
  constexpr double kMinPoints = 50.0;
  std::vector<Eigen::Vector3d> near;
  std::vector<double> heights;
  for (const Eigen::Vector3d& measured : points_in_lidar) {
    const Eigen::Vector3d point(measured.x(), sign * measured.y(), sign * measured.z());
    if (point.head<2>().norm() > kMaxRangeM || point.z() > 0.0) continue;
    near.push_back(point);
    heights.push_back(point.z());
  }
  if (near.size() < 2 * kMinPoints) return std::nullopt;
  // The ground is the lowest large thing below the sensor: start from a low quantile of what lies
  // below it and keep what is close to the plane, closer in every round.
  const auto low = heights.begin() + static_cast<std::ptrdiff_t>(heights.size() / 4);
  std::nth_element(heights.begin(), low, heights.end());
  Eigen::Vector3d plane(0.0, 0.0, *low);  // z = a x + b y + c
  Ground ground;
  for (const double gate_m : {1.0, 0.6, 0.4, 0.3, 0.2, 0.15, 0.15}) {
    Eigen::Matrix3d normal_matrix = 1e-6 * Eigen::Matrix3d::Identity();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& point : near) {
      const Eigen::Vector3d row(point.x(), point.y(), 1.0);
      if (std::abs(row.dot(plane) - point.z()) > gate_m) continue;
      normal_matrix += row * row.transpose();
      right += row * point.z();
    }
    ground.num_points = normal_matrix(2, 2);
    if (ground.num_points < kMinPoints) return std::nullopt;
    plane = normal_matrix.ldlt().solve(right);
  }
  const Eigen::Vector3d up = Eigen::Vector3d(-plane.x(), -plane.y(), 1.0).normalized();
  if (std::acos(std::min(up.z(), 1.0)) > kMaxTiltRad) return std::nullopt;
  ground.up = Eigen::Vector3d(up.x(), sign * up.y(), sign * up.z());
  return ground;
}

}  // namespace

Eigen::Vector3d EstimateUpFromGround(const std::vector<Eigen::Vector3d>& points_in_lidar) {
  // Upside down only when that explains far more: a tunnel's ceiling is as flat as its road.
  constexpr double kClearlyMore = 3.0;
  const auto upright = FindGround(points_in_lidar, 1.0);
  const auto inverted = FindGround(points_in_lidar, -1.0);
  if (inverted && inverted->num_points > kClearlyMore * (upright ? upright->num_points : 100.0)) {
    return inverted->up;
  }
  return upright ? upright->up : Eigen::Vector3d::UnitZ();
}

}  // namespace scenecalib
