#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "scenecalib/mapping/voxel_index.h"

namespace scenecalib {

/// Count, sum and outer-product sum of points about a reference point: the sums of two sets add.
struct PointMoments {
  double count = 0.0;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d outer = Eigen::Matrix3d::Zero();

  void Add(const Eigen::Vector3d& offset) {
    count += 1.0;
    sum += offset;
    outer.noalias() += offset * offset.transpose();
  }
  void Add(const PointMoments& other) {
    count += other.count;
    sum += other.sum;
    outer += other.outer;
  }
  /// The same points about a reference moved by -shift (each offset grows by shift).
  PointMoments Shifted(const Eigen::Vector3d& shift) const {
    PointMoments moved = *this;
    moved.outer +=
        sum * shift.transpose() + shift * sum.transpose() + count * shift * shift.transpose();
    moved.sum += count * shift;
    return moved;
  }
  Eigen::Vector3d Mean() const { return sum / count; }
  Eigen::Matrix3d Covariance() const {
    const Eigen::Vector3d mean = Mean();
    return outer / count - mean * mean.transpose();
  }
};

/// Integer voxel of a point; 21 bits per axis packed into one key.
struct VoxelKey {
  static constexpr std::int64_t kOffset = 1 << 20;  ///< middle of the 21 bits of an axis
  static constexpr std::uint64_t kMask = (1ULL << 21) - 1;

  static std::uint64_t Of(const Eigen::Vector3d& point_m, double voxel_size_m) {
    return OfScaled(point_m / voxel_size_m);
  }
  /// Of a point in units of the voxel's edge.
  static std::uint64_t OfScaled(const Eigen::Vector3d& point) {
    return (Cell(point.x()) << 42) | (Cell(point.y()) << 21) | Cell(point.z());
  }
  static Eigen::Vector3d Center(std::uint64_t key, double voxel_size_m);
  /// The voxel of twice the edge that holds this one.
  static std::uint64_t Parent(std::uint64_t key);

 private:
  static std::uint64_t Cell(double coordinate) {
    // Truncation after the shift to positive numbers rounds down, and is cheaper than floor().
    return static_cast<std::uint64_t>(
               static_cast<std::int64_t>(coordinate + static_cast<double>(kOffset))) &
           kMask;
  }
};

/// A plane of the local map as seen from one query point.
struct PlaneMatch {
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  double distance_m = 0.0;  ///< signed, along the normal
  double sigma_m = 0.0;     ///< thickness of the plane
};

/// The odometry's local map: running point moments in voxels of three sizes; a point is matched to
/// the plane of the finest voxel around it that is planar. Memory: about 200 bytes per voxel.
class VoxelPlaneMap {
 public:
  static constexpr int kNumLevels = 3;

  explicit VoxelPlaneMap(double finest_voxel_size_m);

  void Insert(const std::vector<Eigen::Vector3d>& points_in_map_m);
  /// Drops voxels farther than max_range_m from the centre. Takes effect only once the centre has
  /// moved by a share of that range since the last time: it visits every voxel.
  void ForgetBeyond(const Eigen::Vector3d& center_in_map_m, double max_range_m);
  void Clear();
  bool empty() const { return levels_[0].index.empty(); }
  std::size_t num_voxels() const { return levels_[0].index.size(); }

  /// False when no planar voxel of levels [first_level, 3) holds the point.
  bool Match(const Eigen::Vector3d& point_in_map_m, int first_level, PlaneMatch* match) const;

 private:
  struct Plane {
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    double offset_m = 0.0;  ///< of the plane from the map's origin, along the normal
    float sigma_m = 0.0F;
    bool planar = false;
  };
  /// Voxels of one size; entry i of each list belongs to the voxel with number i.
  struct Level {
    double voxel_size_m = 1.0;
    double voxels_per_m = 1.0;
    VoxelIndex index;
    std::vector<std::uint64_t> keys;
    std::vector<PointMoments> moments;  ///< about the voxel's centre
    std::vector<Plane> planes;
    std::vector<double> fitted_count;  ///< moments.count when the plane was fitted
    std::vector<std::uint32_t> touched;
    std::vector<std::uint8_t> is_touched;

    std::uint32_t FindOrAdd(std::uint64_t key);
    void Touch(std::uint32_t voxel);
    void FitTouched();
    void FitPlane(std::uint32_t voxel);
    void ForgetBeyond(const Eigen::Vector3d& center_in_map_m, double max_range_m);
  };

  std::array<Level, kNumLevels> levels_;
  Eigen::Vector3d last_forget_center_m_ = Eigen::Vector3d::Zero();
};

}  // namespace scenecalib
