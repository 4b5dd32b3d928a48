#pragma once

#include <Eigen/Core>
#include <vector>

#include "plane_fit.h"

namespace scenecalib {

/// A disc's place in a patch's plane.
struct PatchDisc {
  Eigen::Vector3f center_m = Eigen::Vector3f::Zero();
  float radius_m = 0.0F;
  bool at_border = false;  ///< reaches over the patch's border: occludes, but is no plane there
};

/// What decides whether a cell of a patch lies on its plane.
struct PatchGates {
  float noise_m = 0.02F;
  float max_bias_m = 0.01F;
};

/// The part of a plane that the points of one voxel support, as a raster of cells in the plane.
class PlanarPatch {
 public:
  /// `points` are the voxel's and those of a margin around it; `own` says which are the voxel's.
  PlanarPatch(const PlaneFit& plane, const std::vector<Eigen::Vector3f>& points,
              const std::vector<char>& own, float voxel_edge_m, const PatchGates& gates);

  /// Area of the cells on the plane, m^2.
  float area_m2() const { return static_cast<float>(num_on_plane_) * cell_m_ * cell_m_; }
  /// The narrower extent of the cells on the plane.
  float narrow_extent_m() const;
  /// Whether the patch explains a point: near the plane, in a cell that lies on it.
  bool Explains(const Eigen::Vector3f& point_m) const;
  /// Whether a point is a stray return of the patch: in a cell that lies on it, and no farther off
  /// than noise and grazed edges put a few. A few such points are no surface of their own.
  bool Absorbs(const Eigen::Vector3f& point_m) const;
  /// Discs over the cells on the plane that hold own points. In the patch's interior they overlap;
  /// along its border they end where the points do, and a larger disc (at_border) surrounds them.
  std::vector<PatchDisc> Discs() const;

 private:
  struct Cell {
    int num_near = 0;       // within kNearGates of the plane
    int num_on = 0;         // inliers
    int num_own = 0;        // inliers of the voxel itself
    double sum_m = 0.0;     // of the inliers' signed distances
    Eigen::Vector2f min_m;  // box of the inliers in the plane
    Eigen::Vector2f max_m;
    bool on_plane = false;
  };
  Eigen::Vector2f InPlane(const Eigen::Vector3f& point_m) const {
    const Eigen::Vector3f offset = point_m - plane_.center_m;
    return {plane_.axis_u.dot(offset), plane_.axis_v.dot(offset)};
  }
  int CellOf(const Eigen::Vector2f& in_plane_m) const;
  bool OnPlane(int x, int y) const {
    return x >= 0 && y >= 0 && x < width_ && y < width_ && cells_[y * width_ + x].on_plane;
  }
  bool IsWithin(const Eigen::Vector3f& point_m, float sigmas) const;
  bool IsInterior(int x, int y) const {
    return OnPlane(x, y) && OnPlane(x - 1, y) && OnPlane(x + 1, y) && OnPlane(x, y - 1) &&
           OnPlane(x, y + 1);
  }
  Eigen::Vector2f CornerOf(int x, int y) const {
    return cell_m_ *
           Eigen::Vector2f(static_cast<float>(x - width_ / 2), static_cast<float>(y - width_ / 2));
  }
  Eigen::Vector3f InMap(const Eigen::Vector2f& in_plane_m) const {
    return plane_.center_m + in_plane_m.x() * plane_.axis_u + in_plane_m.y() * plane_.axis_v;
  }
  PatchDisc Around(const Eigen::Vector2f& min_m, const Eigen::Vector2f& max_m) const;
  void AppendBorderCell(int x, int y, std::vector<PatchDisc>* discs) const;

  PlaneFit plane_;
  PatchGates gates_;
  float cell_m_ = 0.1F;
  int width_ = 0;
  int num_on_plane_ = 0;
  std::vector<Cell> cells_;
};

}  // namespace scenecalib
