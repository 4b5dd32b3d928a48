#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <unordered_map>
#include <vector>

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
  static std::uint64_t Of(const Eigen::Vector3d& point_m, double voxel_size_m);
  static Eigen::Vector3d Center(std::uint64_t key, double voxel_size_m);
};

/// A plane of the local map as seen from one query point.
struct PlaneMatch {
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  double distance_m = 0.0;  ///< signed, along the normal
  double sigma_m = 0.0;     ///< thickness of the plane
};

/// The odometry's local map: running point moments in voxels of three sizes; a point is matched to
/// the plane of the finest voxel around it that is planar.
class VoxelPlaneMap {
 public:
  explicit VoxelPlaneMap(double finest_voxel_size_m);

  void Insert(const std::vector<Eigen::Vector3d>& points_in_map_m);
  /// Drops voxels farther than max_range_m from the centre.
  void ForgetBeyond(const Eigen::Vector3d& center_in_map_m, double max_range_m);
  void Clear();
  bool empty() const { return levels_[0].empty(); }
  std::size_t num_voxels() const { return levels_[0].size(); }

  /// False when no planar voxel of levels [first_level, 3) holds the point.
  bool Match(const Eigen::Vector3d& point_in_map_m, int first_level, PlaneMatch* match) const;

  static constexpr int kNumLevels = 3;

 private:
  struct Voxel {
    PointMoments moments;  ///< about the voxel's centre
    Eigen::Vector3d point = Eigen::Vector3d::Zero();
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    double sigma_m = 0.0;
    bool planar = false;
    bool dirty = false;
  };
  struct KeyHash {
    std::size_t operator()(std::uint64_t key) const {
      key *= 0x9e3779b97f4a7c15ULL;
      return static_cast<std::size_t>(key ^ (key >> 29));
    }
  };
  static void FitPlane(const Eigen::Vector3d& center_m, double voxel_size_m, Voxel* voxel);

  std::array<double, kNumLevels> voxel_size_m_;
  std::array<std::unordered_map<std::uint64_t, Voxel, KeyHash>, kNumLevels> levels_;
};

}  // namespace scenecalib
