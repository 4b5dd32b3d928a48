#pragma once

#include <Eigen/Core>
#include <vector>

#include "scenecalib/simulation/mesh.h"

namespace scenecalib {

/// The recording vehicle's own body, as far as its sensors see it: bonnet, roof, sides. In the
/// vehicle frame (see VehicleMotion).
struct OwnVehicle {
  struct Box {
    Eigen::Vector3d low_m, high_m;
  };
  Mesh mesh;
  std::vector<Box> boxes;

  /// True when a sensor there sits inside the body (and then does not see it), with a margin.
  bool Contains(const Eigen::Vector3d& point_in_vehicle_m) const;
};

/// A body that keeps below a lidar of that height.
OwnVehicle MakeOwnVehicle(double lidar_height_m);

}  // namespace scenecalib
