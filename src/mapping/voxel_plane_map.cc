#include "scenecalib/mapping/voxel_plane_map.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <utility>

namespace scenecalib {
namespace {

constexpr double kMinPlanePoints = 8.0;
/// Moments are halved beyond this count, so that the map follows what was seen last.
constexpr double kMaxPlanePoints = 400.0;
/// A plane is fitted anew when its voxel's points have grown by this share.
constexpr double kRefitGrowth = 0.15;
constexpr double kForgetStep = 0.05;  // of the range

}  // namespace

Eigen::Vector3d VoxelKey::Center(std::uint64_t key, double voxel_size_m) {
  Eigen::Vector3d center;
  for (int axis = 2; axis >= 0; --axis) {
    const auto cell = static_cast<std::int64_t>(key & kMask) - kOffset;
    center[axis] = (static_cast<double>(cell) + 0.5) * voxel_size_m;
    key >>= 21;
  }
  return center;
}

std::uint64_t VoxelKey::Parent(std::uint64_t key) {
  std::uint64_t parent = 0;
  for (const int shift : {42, 21, 0}) {
    // Halving the shifted cell halves the offset too: add the missing half.
    const std::uint64_t cell = ((key >> shift) & kMask) / 2 + kOffset / 2;
    parent |= (cell & kMask) << shift;
  }
  return parent;
}

VoxelPlaneMap::VoxelPlaneMap(double finest_voxel_size_m) {
  double size_m = finest_voxel_size_m;
  for (Level& level : levels_) {
    level.voxel_size_m = size_m;
    level.voxels_per_m = 1.0 / size_m;
    size_m *= 2.0;
  }
}

std::uint32_t VoxelPlaneMap::Level::FindOrAdd(std::uint64_t key) {
  const std::uint32_t voxel = index.FindOrAdd(key);
  if (voxel == keys.size()) {
    keys.push_back(key);
    moments.emplace_back();
    planes.emplace_back();
    fitted_count.push_back(0.0);
    is_touched.push_back(0);
  }
  return voxel;
}

void VoxelPlaneMap::Level::Touch(std::uint32_t voxel) {
  if (is_touched[voxel]) return;
  is_touched[voxel] = 1;
  touched.push_back(voxel);
}

void VoxelPlaneMap::Insert(const std::vector<Eigen::Vector3d>& points_in_map_m) {
  // Gather what is new in the finest voxels; the coarser ones then take sums instead of points.
  Level& finest = levels_[0];
  VoxelIndex fresh_index(points_in_map_m.size());
  std::vector<PointMoments> fresh;
  std::vector<std::uint64_t> fresh_keys;
  for (const Eigen::Vector3d& point : points_in_map_m) {
    const std::uint64_t key = VoxelKey::OfScaled(point * finest.voxels_per_m);
    const std::uint32_t number = fresh_index.FindOrAdd(key);
    if (number == fresh.size()) {
      fresh.emplace_back();
      fresh_keys.push_back(key);
    }
    fresh[number].Add(point - VoxelKey::Center(key, finest.voxel_size_m));
  }
  for (std::size_t i = 0; i < fresh.size(); ++i) {
    std::uint64_t key = fresh_keys[i];
    const Eigen::Vector3d center_m = VoxelKey::Center(key, finest.voxel_size_m);
    for (Level& level : levels_) {
      const std::uint32_t voxel = level.FindOrAdd(key);
      const Eigen::Vector3d shift_m = center_m - VoxelKey::Center(key, level.voxel_size_m);
      level.moments[voxel].Add(fresh[i].Shifted(shift_m));
      level.Touch(voxel);
      key = VoxelKey::Parent(key);
    }
  }
  for (Level& level : levels_) level.FitTouched();
}

void VoxelPlaneMap::Level::FitTouched() {
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, touched.size(), 256),
                    [this](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t i = range.begin(); i != range.end(); ++i) {
                        FitPlane(touched[i]);
                      }
                    });
  for (const std::uint32_t voxel : touched) is_touched[voxel] = 0;
  touched.clear();
}

void VoxelPlaneMap::Level::FitPlane(std::uint32_t voxel) {
  PointMoments& points = moments[voxel];
  if (points.count < kMinPlanePoints) return;
  if (points.count < (1.0 + kRefitGrowth) * fitted_count[voxel]) return;
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen;
  eigen.computeDirect(points.Covariance());
  const Eigen::Vector3d sigma_m = eigen.eigenvalues().cwiseMax(0.0).cwiseSqrt();
  Plane& plane = planes[voxel];
  plane.normal = eigen.eigenvectors().col(0);
  plane.offset_m = plane.normal.dot(VoxelKey::Center(keys[voxel], voxel_size_m) + points.Mean());
  plane.sigma_m = static_cast<float>(sigma_m[0]);
  // Wide both ways in the plane and thin across it; a single scan line is wide one way only.
  plane.planar =
      sigma_m[1] > 0.1 * voxel_size_m && sigma_m[0] < 0.25 * sigma_m[1] && sigma_m[0] < 0.1;
  if (points.count > kMaxPlanePoints) {
    points.count *= 0.5;
    points.sum *= 0.5;
    points.outer *= 0.5;
  }
  fitted_count[voxel] = points.count;
}

void VoxelPlaneMap::Level::ForgetBeyond(const Eigen::Vector3d& center_in_map_m,
                                        double max_range_m) {
  index.Clear();
  for (std::size_t i = 0; i < keys.size(); ++i) {
    const Eigen::Vector3d center_m = VoxelKey::Center(keys[i], voxel_size_m);
    if ((center_m - center_in_map_m).squaredNorm() > max_range_m * max_range_m) continue;
    const std::uint32_t kept = index.FindOrAdd(keys[i]);
    keys[kept] = keys[i];
    moments[kept] = moments[i];
    planes[kept] = planes[i];
    fitted_count[kept] = fitted_count[i];
  }
  keys.resize(index.size());
  moments.resize(index.size());
  planes.resize(index.size());
  fitted_count.resize(index.size());
  is_touched.assign(index.size(), 0);
}

void VoxelPlaneMap::ForgetBeyond(const Eigen::Vector3d& center_in_map_m, double max_range_m) {
  if ((center_in_map_m - last_forget_center_m_).norm() < kForgetStep * max_range_m) return;
  last_forget_center_m_ = center_in_map_m;
  for (Level& level : levels_) level.ForgetBeyond(center_in_map_m, max_range_m);
}

void VoxelPlaneMap::Clear() { *this = VoxelPlaneMap(levels_[0].voxel_size_m); }

bool VoxelPlaneMap::Match(const Eigen::Vector3d& point_in_map_m, int first_level,
                          PlaneMatch* match) const {
  const Level& first = levels_[first_level];
  std::uint64_t key = VoxelKey::OfScaled(point_in_map_m * first.voxels_per_m);
  for (int level = first_level; level < kNumLevels; ++level) {
    const std::uint32_t voxel = levels_[level].index.Find(key);
    if (voxel != VoxelIndex::kNone && levels_[level].planes[voxel].planar) {
      const Plane& plane = levels_[level].planes[voxel];
      match->normal = plane.normal;
      match->distance_m = plane.normal.dot(point_in_map_m) - plane.offset_m;
      match->sigma_m = plane.sigma_m;
      return true;
    }
    key = VoxelKey::Parent(key);
  }
  return false;
}

}  // namespace scenecalib
