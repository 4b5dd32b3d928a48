#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "scenecalib/geometry/rigid3.h"

namespace scenecalib {

/// What a surface is made of; decides its texture.
enum class Material {
  kAsphalt,     ///< with markings; u along the road, v across it
  kPaving,      ///< slabs of a sidewalk
  kCobbles,     ///< the plaza's ground
  kStone,       ///< kerbs, plinths, columns
  kPlaster,     ///< facades
  kBrick,       ///< facades, walls
  kRoof,        ///< tiles
  kWindow,      ///< glass in a frame; uv from the pane's corner, size in `extent`
  kDoor,        ///< panels; uv as kWindow
  kSign,        ///< glyphs on a plate; uv as kWindow
  kBark,        ///< tree trunks
  kLeaves,      ///< leaves, each with its own shade
  kGrass,       ///< lawns and hedges
  kMetal,       ///< poles, railings, wheels
  kCarPaint,    ///< with panel gaps
  kDarkGlass,   ///< car windows
  kSheet,       ///< corrugated metal: halls, containers; ribs run along v
  kFieldStone,  ///< walls of rough stones in joints
};

/// Appearance that many triangles share.
struct Surface {
  Material material = Material::kPlaster;
  Eigen::Vector3f albedo = Eigen::Vector3f::Constant(0.5F);  ///< linear blue, green, red
  std::uint32_t seed = 0;
  Eigen::Vector2f extent_m = Eigen::Vector2f::Ones();  ///< of panes and plates
  std::uint32_t object_id = 0;
};

/// Texture coordinates of one triangle: metres on the surface, and their gradients in space (for
/// the footprint of a pixel).
struct TriangleTexture {
  std::uint32_t surface = 0;
  Eigen::Vector2f uv[3];
  Eigen::Vector3f u_gradient;  ///< metres of u per metre of space
  Eigen::Vector3f v_gradient;
};

/// A triangle soup with textures. Texture coordinates are metres, so a texture has the same grain
/// everywhere.
class Mesh {
 public:
  std::uint32_t AddSurface(const Surface& surface);
  void AddTriangle(const Eigen::Vector3d points[3], const Eigen::Vector2d uv[3],
                   std::uint32_t surface);
  /// Corners in order around the quad, uv with them.
  void AddQuad(const Eigen::Vector3d& p0, const Eigen::Vector3d& p1, const Eigen::Vector3d& p2,
               const Eigen::Vector3d& p3, const Eigen::Vector2d& uv0, const Eigen::Vector2d& uv1,
               const Eigen::Vector2d& uv2, const Eigen::Vector2d& uv3, std::uint32_t surface);
  /// A parallelogram from a corner and two edges; uv from uv_corner along the edges, in metres.
  void AddPatch(const Eigen::Vector3d& corner, const Eigen::Vector3d& edge_u,
                const Eigen::Vector3d& edge_v, const Eigen::Vector2d& uv_corner,
                std::uint32_t surface);
  /// A box [0, size] in the frame `world_from_box`; every face has its own part of the texture.
  void AddBox(const Rigid3& world_from_box, const Eigen::Vector3d& size_m, std::uint32_t surface);
  /// An upright or tilted tube without caps, from `bottom` to `top`.
  void AddTube(const Eigen::Vector3d& bottom, const Eigen::Vector3d& top, double bottom_radius_m,
               double top_radius_m, int sides, std::uint32_t surface);

  std::size_t num_triangles() const { return textures_.size(); }
  const std::vector<Eigen::Vector3f>& vertices() const { return vertices_; }  ///< 3 per triangle
  const std::vector<TriangleTexture>& textures() const { return textures_; }
  const std::vector<Surface>& surfaces() const { return surfaces_; }

 private:
  std::vector<Eigen::Vector3f> vertices_;
  std::vector<TriangleTexture> textures_;
  std::vector<Surface> surfaces_;
};

}  // namespace scenecalib
