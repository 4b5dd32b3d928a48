#pragma once

#include <Eigen/Core>

#include "scenecalib/base/random.h"
#include "scenecalib/simulation/mesh.h"

namespace scenecalib {

/// A tree: bent trunk, and 9 to 13 clusters of single leaves (triangles of a few decimetres). The
/// crown is also added to `shadow_mesh`, as blobs: the shadows of single leaves would only be
/// noise.
void AddTree(const Eigen::Vector3d& foot_in_map_m, double height_m, int leaves_per_cluster,
             std::uint32_t object_id, Random random, Mesh* mesh, Mesh* shadow_mesh);

/// A street lamp or a traffic sign; `road_from_here` is the horizontal direction to the road.
void AddLamp(const Eigen::Vector3d& foot_in_map_m, const Eigen::Vector3d& towards_road,
             std::uint32_t object_id, Random random, Mesh* mesh);
void AddSignPost(const Eigen::Vector3d& foot_in_map_m, const Eigen::Vector3d& facing,
                 std::uint32_t object_id, Random random, Mesh* mesh);

/// Small things on the pavement, chosen at random: bench, bin, bollard, switch box, planter.
void AddFurniture(const Eigen::Vector3d& foot_in_map_m, double heading_rad, std::uint32_t object_id,
                  Random random, Mesh* mesh);

/// A stone column on a plinth, or a monument of stacked blocks.
void AddColumn(const Eigen::Vector3d& foot_in_map_m, double height_m, std::uint32_t object_id,
               Random random, Mesh* mesh);
void AddMonument(const Eigen::Vector3d& foot_in_map_m, std::uint32_t object_id, Random random,
                 Mesh* mesh);

/// A car of random colour and shape, about 4.3 m long: body with bonnet and cabin, windows, wheels,
/// lights, plates. Car frame: x forward, y left, z up, origin on the ground below its middle.
void AddCar(const Rigid3& map_from_car, std::uint32_t object_id, Random random, Mesh* mesh);

}  // namespace scenecalib
