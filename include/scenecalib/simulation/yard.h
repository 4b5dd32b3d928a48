#pragma once

#include <Eigen/Core>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/simulation/mesh.h"

namespace scenecalib {

/// A hall: where its front stands.
struct HallSpec {
  Eigen::Vector3d front_left_m = Eigen::Vector3d::Zero();  ///< ground, seen from the street
  Eigen::Vector3d front_right_m = Eigen::Vector3d::Zero();
  double depth_m = 20.0;
  double height_m = 9.0;
  std::uint32_t object_id = 0;
};

/// A large flat-roofed shed of corrugated sheet on a plinth: gates, a door, a band of windows high
/// up, pipes, a sign; nothing on the other sides.
void AddHall(const HallSpec& spec, Random random, Mesh* mesh);

/// A stack of one to three containers, 6 or 12 m long along the heading.
void AddContainers(const Eigen::Vector3d& foot_in_map_m, double heading_rad,
                   std::uint32_t object_id, Random random, Mesh* mesh);

/// A fence of upright steel bars between posts at these places on the ground.
void AddFence(const std::vector<Eigen::Vector3d>& posts_in_map_m, std::uint32_t object_id,
              Random random, Mesh* mesh);

}  // namespace scenecalib
