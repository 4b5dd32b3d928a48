#pragma once

#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/mapping/scene_map.h"

namespace scenecalib {

enum class PlyFormat { kAscii, kBinary };  ///< binary is little endian

/// Writes a mesh in the map frame, metres: vertices x y z and triangles. Unavailable, with the
/// path, when the file cannot be written.
Status WritePly(const std::string& path, const TriangleMesh& mesh, PlyFormat format);

/// Writes surfels as points: x y z, nx ny nz, radius, thickness, scale, planar (0 or 1).
Status WritePly(const std::string& path, const std::vector<Surfel>& surfels, PlyFormat format);

}  // namespace scenecalib
