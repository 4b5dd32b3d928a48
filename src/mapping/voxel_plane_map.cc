#include "scenecalib/mapping/voxel_plane_map.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace scenecalib {
namespace {

constexpr std::int64_t kKeyOffset = 1 << 20;  // middle of the 21 bits of an axis
constexpr std::uint64_t kKeyMask = (1ULL << 21) - 1;
constexpr double kMinPlanePoints = 8.0;
/// Moments are halved beyond this count, so that the map follows what was seen last.
constexpr double kMaxPlanePoints = 400.0;

}  // namespace

std::uint64_t VoxelKey::Of(const Eigen::Vector3d& point_m, double voxel_size_m) {
  std::uint64_t key = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const auto cell = static_cast<std::int64_t>(std::floor(point_m[axis] / voxel_size_m));
    key = (key << 21) | (static_cast<std::uint64_t>(cell + kKeyOffset) & kKeyMask);
  }
  return key;
}

Eigen::Vector3d VoxelKey::Center(std::uint64_t key, double voxel_size_m) {
  Eigen::Vector3d center;
  for (int axis = 2; axis >= 0; --axis) {
    const auto cell = static_cast<std::int64_t>(key & kKeyMask) - kKeyOffset;
    center[axis] = (static_cast<double>(cell) + 0.5) * voxel_size_m;
    key >>= 21;
  }
  return center;
}

VoxelPlaneMap::VoxelPlaneMap(double finest_voxel_size_m)
    : voxel_size_m_{finest_voxel_size_m, 2.0 * finest_voxel_size_m, 4.0 * finest_voxel_size_m} {}

void VoxelPlaneMap::Insert(const std::vector<Eigen::Vector3d>& points_in_map_m) {
  for (int level = 0; level < kNumLevels; ++level) {
    const double size_m = voxel_size_m_[level];
    std::vector<std::uint64_t> touched;
    for (const Eigen::Vector3d& point : points_in_map_m) {
      const std::uint64_t key = VoxelKey::Of(point, size_m);
      Voxel& voxel = levels_[level][key];
      voxel.moments.Add(point - VoxelKey::Center(key, size_m));
      if (!voxel.dirty) touched.push_back(key);
      voxel.dirty = true;
    }
    for (const std::uint64_t key : touched) {
      FitPlane(VoxelKey::Center(key, size_m), size_m, &levels_[level][key]);
    }
  }
}

void VoxelPlaneMap::FitPlane(const Eigen::Vector3d& center_m, double voxel_size_m, Voxel* voxel) {
  voxel->dirty = false;
  voxel->planar = false;
  if (voxel->moments.count < kMinPlanePoints) return;
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen;
  eigen.computeDirect(voxel->moments.Covariance());
  const Eigen::Vector3d sigma_m = eigen.eigenvalues().cwiseMax(0.0).cwiseSqrt();
  voxel->point = center_m + voxel->moments.Mean();
  voxel->normal = eigen.eigenvectors().col(0);
  voxel->sigma_m = sigma_m[0];
  // Wide both ways in the plane and thin across it; a single scan line is wide one way only.
  voxel->planar =
      sigma_m[1] > 0.1 * voxel_size_m && sigma_m[0] < 0.25 * sigma_m[1] && sigma_m[0] < 0.1;
  if (voxel->moments.count > kMaxPlanePoints) {
    voxel->moments.count *= 0.5;
    voxel->moments.sum *= 0.5;
    voxel->moments.outer *= 0.5;
  }
}

void VoxelPlaneMap::ForgetBeyond(const Eigen::Vector3d& center_in_map_m, double max_range_m) {
  for (int level = 0; level < kNumLevels; ++level) {
    auto& voxels = levels_[level];
    for (auto it = voxels.begin(); it != voxels.end();) {
      const Eigen::Vector3d center = VoxelKey::Center(it->first, voxel_size_m_[level]);
      it = (center - center_in_map_m).norm() > max_range_m ? voxels.erase(it) : std::next(it);
    }
  }
}

void VoxelPlaneMap::Clear() {
  for (auto& level : levels_) level.clear();
}

bool VoxelPlaneMap::Match(const Eigen::Vector3d& point_in_map_m, int first_level,
                          PlaneMatch* match) const {
  for (int level = first_level; level < kNumLevels; ++level) {
    const auto it = levels_[level].find(VoxelKey::Of(point_in_map_m, voxel_size_m_[level]));
    if (it == levels_[level].end() || !it->second.planar) continue;
    match->normal = it->second.normal;
    match->distance_m = it->second.normal.dot(point_in_map_m - it->second.point);
    match->sigma_m = it->second.sigma_m;
    return true;
  }
  return false;
}

}  // namespace scenecalib
