#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "scenecalib/mapping/ray_caster.h"
#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/sensor/image_pose.h"

namespace scenecalib {

/// The map's surfaces as one camera sees them in one image: a ray in every cell of a grid over the
/// image. Knows what is hidden and where depth jumps.
class SurfaceView {
 public:
  struct Cell {
    Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
    Eigen::Vector3d point_in_map_m = Eigen::Vector3d::Zero();
    Eigen::Vector3d normal_in_map = Eigen::Vector3d::UnitZ();
    bool hit = false;     ///< a surface that can be told from its surroundings
    bool inside = false;  ///< and the neighbouring cells see the same surface
  };

  /// About `num_cells` cells; their rays go through random pixels of theirs (seeded), so that no
  /// cell is favoured by lying on a pixel's centre.
  SurfaceView(const CameraModel& camera, const ImagePose& pose, const RayCaster& caster,
              int num_cells, int seed);

  const std::vector<Cell>& cells() const { return cells_; }

  /// Whether the point, which projects to the pixel, is seen there, well away from any edge.
  bool Sees(const Eigen::Vector3d& point_in_map_m, const Eigen::Vector2d& pixel) const;

 private:
  const Cell& At(int column, int row) const {
    return cells_[static_cast<std::size_t>(row) * columns_ + column];
  }
  void MarkInside();

  double edge_px_ = 1.0;
  int columns_ = 0;
  int rows_ = 0;
  Eigen::Vector3d origin_in_map_m_ = Eigen::Vector3d::Zero();
  std::vector<Cell> cells_;
};

}  // namespace scenecalib
