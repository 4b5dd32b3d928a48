#include "surface_view.h"

#include <algorithm>
#include <cmath>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr double kMinRange_m = 2.0;  // nearer is the vehicle itself
constexpr double kMaxRange_m = 80.0;
constexpr double kMaxIncidence_rad = 1.45;
/// Two points are on one surface when one is this close to the other's plane; surfaces further away
/// are known less well.
constexpr double kPlaneTolerance_m = 0.04;
constexpr double kPlaneTolerancePerMetre = 0.002;

bool SamePlane(const SurfaceView::Cell& cell, const Eigen::Vector3d& point_m, double range_m) {
  return cell.hit && std::abs(cell.normal_in_map.dot(point_m - cell.point_in_map_m)) <
                         kPlaneTolerance_m + kPlaneTolerancePerMetre * range_m;
}

}  // namespace

SurfaceView::SurfaceView(const CameraModel& camera, const ImagePose& pose, const RayCaster& caster,
                         int num_cells, int seed)
    : origin_in_map_m_(pose.map_from_camera().translation) {
  const double area = static_cast<double>(camera.width_px()) * camera.height_px();
  edge_px_ = std::max(1.0, std::sqrt(area / num_cells));
  columns_ = std::max(1, static_cast<int>(camera.width_px() / edge_px_));
  rows_ = std::max(1, static_cast<int>(camera.height_px() / edge_px_));
  cells_.resize(static_cast<std::size_t>(columns_) * rows_);
  Random random(static_cast<std::uint64_t>(seed));
  const Eigen::Matrix3d rotation = pose.map_from_camera().RotationMatrix();
  for (std::size_t i = 0; i < cells_.size(); ++i) {
    Cell& cell = cells_[i];
    const double column = static_cast<double>(i % static_cast<std::size_t>(columns_));
    const double row = static_cast<double>(i / static_cast<std::size_t>(columns_));
    const double x = edge_px_ * (column + random.Uniform());
    const double y = edge_px_ * (row + random.Uniform());
    cell.pixel = {x - 0.5, y - 0.5};
    const auto ray = camera.Unproject(cell.pixel);
    if (!ray) continue;
    Ray in_map{origin_in_map_m_, rotation * *ray};
    if (pose.is_rolling()) {
      const Rigid3 of_row = pose.At(cell.pixel.y());
      in_map = {of_row.translation, of_row.rotation * *ray};
    }
    const auto hit = caster.Cast(in_map, kMaxRange_m);
    if (!hit || hit->range_m < kMinRange_m) continue;
    cell.point_in_map_m = hit->point_in_map_m;
    cell.normal_in_map = hit->normal_in_map;
    cell.hit = hit->planar && hit->incidence_angle_rad < kMaxIncidence_rad;
  }
  MarkInside();
}

void SurfaceView::MarkInside() {
  for (int row = 1; row + 1 < rows_; ++row) {
    for (int column = 1; column + 1 < columns_; ++column) {
      Cell& cell = cells_[static_cast<std::size_t>(row) * columns_ + column];
      const double range_m = (cell.point_in_map_m - origin_in_map_m_).norm();
      const auto same = [&](const Cell& other) {
        return other.hit && SamePlane(cell, other.point_in_map_m, range_m);
      };
      cell.inside = cell.hit && same(At(column - 1, row)) && same(At(column + 1, row)) &&
                    same(At(column, row - 1)) && same(At(column, row + 1));
    }
  }
}

bool SurfaceView::Sees(const Eigen::Vector3d& point_in_map_m, const Eigen::Vector2d& pixel) const {
  const int column = static_cast<int>((pixel.x() + 0.5) / edge_px_);
  const int row = static_cast<int>((pixel.y() + 0.5) / edge_px_);
  if (column < 0 || row < 0 || column >= columns_ || row >= rows_) return false;
  const Cell& cell = At(column, row);
  return cell.inside && SamePlane(cell, point_in_map_m, (point_in_map_m - origin_in_map_m_).norm());
}

}  // namespace scenecalib
