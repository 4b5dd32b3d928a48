#pragma once

#include <Eigen/Geometry>

namespace scenecalib {

/// A wall's own coordinates: x along it (seen from outside, left to right), y up, z outwards.
struct WallFrame {
  Eigen::Vector3d origin, right, up, out;
  double width_m;
  Eigen::Vector3d At(double x, double y, double z) const {
    return origin + x * right + y * up + z * out;
  }
};

/// The wall from `left` to `right` on the ground, seen from outside.
inline WallFrame MakeWall(const Eigen::Vector3d& left, const Eigen::Vector3d& right) {
  WallFrame wall;
  wall.origin = left;
  const Eigen::Vector3d along = right - left;
  wall.width_m = along.norm();
  wall.right = along / wall.width_m;
  wall.up = Eigen::Vector3d::UnitZ();
  wall.out = wall.right.cross(wall.up).normalized();
  wall.up = wall.out.cross(wall.right);
  return wall;
}

}  // namespace scenecalib
