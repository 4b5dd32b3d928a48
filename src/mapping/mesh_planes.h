#pragma once

#include <Eigen/Core>
#include <vector>

#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

/// The plane that the ground is taken for around one triangle.
struct MeshPlane {
  Eigen::Vector3d point_m = Eigen::Vector3d::Zero();  ///< in the map
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< unit, upwards
  double scale_m = 0.0;                               ///< edge of the square it was fitted over
  double thickness_m = 0.0;                           ///< RMS height of the vertices about it
  bool planar = false;                                ///< false: a kerb's edge, a step, a pothole
};

/// For every triangle of a ground mesh the widest plane (0.6 m up to 3 m) that agrees with the mesh
/// around it; what lies beyond a kerb or at the foot of a wall has no say. A triangle of a few
/// centimetres has a normal that is noise; a calibration wants the plane of the neighbourhood.
/// Where no such plane holds, the triangle itself, not planar.
std::vector<MeshPlane> FitMeshPlanes(const TriangleMesh& mesh);

}  // namespace scenecalib
