#include "planar_patch.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "scenecalib/base/floor.h"

namespace scenecalib {
namespace {

constexpr float kInlierSigmas = 2.5F;
/// Points this near to the plane, but no inliers, are another surface that the cell also holds.
constexpr float kNearSigmas = 8.0F;
constexpr float kMinInlierShare = 0.7F;
/// Points this near, in a cell on the plane, are its own strays.
constexpr float kStraySigmas = 6.0F;
/// A cell's mean offset may be this many of its standard errors; fewer points, less evidence.
constexpr float kBiasSigmas = 3.0F;
/// Cells per voxel edge, and the finest cell that lidar noise and spacing leave a meaning.
constexpr float kCellsPerEdge = 8.0F;
constexpr float kMinCell_m = 0.1F;
/// Sparse data takes larger cells, so that a cell holds about this many points.
constexpr float kPointsPerCell = 4.0F;
/// Discs circumscribe their square with a little overlap, so that no ray slips between.
constexpr float kDiscOverlap = 1.02F;
constexpr float kMinRadius_m = 0.03F;
/// Inscribed discs reach this much over their box: half of the spacing of returns nearby.
constexpr float kReach_m = 0.005F;

}  // namespace

PlanarPatch::PlanarPatch(const PlaneFit& plane, const std::vector<Eigen::Vector3f>& points,
                         const std::vector<char>& own, float voxel_edge_m, const PatchGates& gates)
    : plane_(plane), gates_(gates) {
  const float extent_m = 2.0F * voxel_edge_m;  // covers the voxel's diagonal and the margin
  // Area per inlier as if they filled their own ellipse evenly (RMS extent e: width e sqrt(12)).
  const float inlier_gate_m = kInlierSigmas * gates_.noise_m;
  Eigen::Vector2f squares = Eigen::Vector2f::Zero();
  int num_inliers = 0;
  for (const Eigen::Vector3f& point : points) {
    if (std::abs(plane_.Distance(point)) > inlier_gate_m) continue;
    squares += InPlane(point).cwiseAbs2();
    ++num_inliers;
  }
  if (num_inliers == 0) return;
  const Eigen::Vector2f width_m = (12.0F * squares / static_cast<float>(num_inliers)).cwiseSqrt();
  const float spacing_cell_m =
      std::sqrt(kPointsPerCell * width_m.prod() / static_cast<float>(num_inliers));
  cell_m_ = std::clamp(spacing_cell_m, std::max(kMinCell_m, voxel_edge_m / kCellsPerEdge),
                       std::max(kMinCell_m, 0.5F * voxel_edge_m));
  width_ = 2 * static_cast<int>(std::ceil(0.5F * extent_m / cell_m_)) + 2;
  cells_.resize(static_cast<std::size_t>(width_) * width_);

  for (std::size_t i = 0; i < points.size(); ++i) {
    const float distance_m = plane_.Distance(points[i]);
    if (std::abs(distance_m) > kNearSigmas * gates_.noise_m) continue;
    const Eigen::Vector2f in_plane_m = InPlane(points[i]);
    const int index = CellOf(in_plane_m);
    if (index < 0) continue;
    Cell& cell = cells_[index];
    ++cell.num_near;
    if (std::abs(distance_m) > inlier_gate_m) continue;
    if (cell.num_on == 0) cell.min_m = cell.max_m = in_plane_m;
    cell.min_m = cell.min_m.cwiseMin(in_plane_m);
    cell.max_m = cell.max_m.cwiseMax(in_plane_m);
    ++cell.num_on;
    cell.sum_m += distance_m;
    if (own[i]) ++cell.num_own;
  }
  for (Cell& cell : cells_) {
    if (cell.num_on < 2 || cell.num_on < kMinInlierShare * static_cast<float>(cell.num_near)) {
      continue;
    }
    const float count = static_cast<float>(cell.num_on);
    const float bias_m = static_cast<float>(std::abs(cell.sum_m)) / count;
    cell.on_plane =
        bias_m <= std::max(gates_.max_bias_m, kBiasSigmas * gates_.noise_m / std::sqrt(count));
    if (cell.on_plane) ++num_on_plane_;
  }
}

int PlanarPatch::CellOf(const Eigen::Vector2f& in_plane_m) const {
  const int x = static_cast<int>(Floor(in_plane_m.x() / cell_m_)) + width_ / 2;
  const int y = static_cast<int>(Floor(in_plane_m.y() / cell_m_)) + width_ / 2;
  if (x < 0 || y < 0 || x >= width_ || y >= width_) return -1;
  return y * width_ + x;
}

float PlanarPatch::narrow_extent_m() const {
  // RMS extents of a filled rectangle: width / sqrt(12). The raster's axes are the principal ones.
  Eigen::Array2f sum = Eigen::Array2f::Zero();
  Eigen::Array2f squares = Eigen::Array2f::Zero();
  for (int y = 0; y < width_; ++y) {
    for (int x = 0; x < width_; ++x) {
      if (!OnPlane(x, y)) continue;
      const Eigen::Array2f place(static_cast<float>(x), static_cast<float>(y));
      sum += place;
      squares += place * place;
    }
  }
  if (num_on_plane_ == 0) return 0.0F;
  const float count = static_cast<float>(num_on_plane_);
  const Eigen::Array2f variance = squares / count - (sum / count).square();
  // One cell alone has a width too: that of a uniform cell.
  return cell_m_ * std::sqrt(12.0F * variance.minCoeff() + 1.0F);
}

bool PlanarPatch::Explains(const Eigen::Vector3f& point_m) const {
  return IsWithin(point_m, kInlierSigmas + 1.0F);
}

bool PlanarPatch::Absorbs(const Eigen::Vector3f& point_m) const {
  return IsWithin(point_m, kStraySigmas);
}

bool PlanarPatch::IsWithin(const Eigen::Vector3f& point_m, float sigmas) const {
  if (std::abs(plane_.Distance(point_m)) > sigmas * gates_.noise_m) return false;
  const int index = CellOf(InPlane(point_m));
  return index >= 0 && cells_[index].on_plane;
}

/// Circumscribes a square of the interior.
PatchDisc PlanarPatch::Around(const Eigen::Vector2f& min_m, const Eigen::Vector2f& max_m) const {
  PatchDisc disc;
  disc.center_m = InMap(0.5F * (min_m + max_m));
  disc.radius_m = std::max(kMinRadius_m, kDiscOverlap * 0.5F * (max_m - min_m).norm());
  return disc;
}

/// The cell's own points say where the patch ends; towards neighbours on the plane it reaches up to
/// them. Discs inscribed into that box are planar, the one around it is not.
void PlanarPatch::AppendBorderCell(int x, int y, std::vector<PatchDisc>* discs) const {
  const Cell& cell = cells_[y * width_ + x];
  const Eigen::Vector2f low_m = CornerOf(x, y);
  const Eigen::Vector2f high_m = CornerOf(x + 1, y + 1);
  const Eigen::Vector2f min_m(OnPlane(x - 1, y) ? low_m.x() : cell.min_m.x(),
                              OnPlane(x, y - 1) ? low_m.y() : cell.min_m.y());
  const Eigen::Vector2f max_m(OnPlane(x + 1, y) ? high_m.x() : cell.max_m.x(),
                              OnPlane(x, y + 1) ? high_m.y() : cell.max_m.y());
  PatchDisc rim = Around(min_m, max_m);
  rim.at_border = true;
  discs->push_back(rim);
  const Eigen::Vector2f size_m = max_m - min_m;
  const int axis = size_m.x() >= size_m.y() ? 0 : 1;
  const float narrow_m = size_m[1 - axis];
  if (narrow_m < kMinRadius_m) return;
  const int count = std::clamp(static_cast<int>(std::lround(size_m[axis] / narrow_m)), 1, 3);
  for (int i = 0; i < count; ++i) {
    Eigen::Vector2f center_m = 0.5F * (min_m + max_m);
    center_m[axis] =
        min_m[axis] + size_m[axis] * (static_cast<float>(i) + 0.5F) / static_cast<float>(count);
    PatchDisc disc;
    disc.center_m = InMap(center_m);
    disc.radius_m = 0.5F * std::min(narrow_m, size_m[axis] / static_cast<float>(count)) + kReach_m;
    discs->push_back(disc);
  }
}

std::vector<PatchDisc> PlanarPatch::Discs() const {
  std::vector<PatchDisc> discs;
  for (int y = 0; y < width_; y += 2) {
    for (int x = 0; x < width_; x += 2) {
      bool whole_block = true;
      int num_own = 0;
      for (int k = 0; k < 4; ++k) {
        const int cx = x + k % 2;
        const int cy = y + k / 2;
        whole_block &= IsInterior(cx, cy);
        if (OnPlane(cx, cy)) num_own += cells_[cy * width_ + cx].num_own;
      }
      if (num_own == 0) continue;
      if (whole_block) {
        discs.push_back(Around(CornerOf(x, y), CornerOf(x + 2, y + 2)));
        continue;
      }
      for (int k = 0; k < 4; ++k) {
        const int cx = x + k % 2;
        const int cy = y + k / 2;
        if (!OnPlane(cx, cy) || cells_[cy * width_ + cx].num_own == 0) continue;
        if (IsInterior(cx, cy)) {
          discs.push_back(Around(CornerOf(cx, cy), CornerOf(cx + 1, cy + 1)));
        } else {
          AppendBorderCell(cx, cy, &discs);
        }
      }
    }
  }
  return discs;
}

}  // namespace scenecalib
