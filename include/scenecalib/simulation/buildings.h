#pragma once

#include <Eigen/Core>

#include "scenecalib/base/random.h"
#include "scenecalib/simulation/mesh.h"

namespace scenecalib {

/// A house: where its front stands and how it looks.
struct HouseSpec {
  Eigen::Vector3d front_left_m = Eigen::Vector3d::Zero();  ///< ground, seen from the street
  Eigen::Vector3d front_right_m = Eigen::Vector3d::Zero();
  double depth_m = 8.0;
  double height_m = 11.0;
  bool shop = false;    ///< large panes and a sign on the ground floor
  bool gabled = false;  ///< a gable roof, otherwise a roof that slopes back from the front
  bool windows_on_all_sides = false;
  std::uint32_t object_id = 0;
};

/// Adds a house with relief: recessed windows and doors, plinth, cornices, balconies, pipes, roof.
void AddHouse(const HouseSpec& spec, Random random, Mesh* mesh);

}  // namespace scenecalib
