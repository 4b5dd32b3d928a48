#include "lidar_return.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <array>
#include <limits>
#include <utility>

namespace scenecalib {
namespace {

/// Time of the middle of a scan's points, relative to the first scan's stamp.
double MidScanTime(const RegisteredScan& scan, Timestamp reference_ns) {
  float first_s = 0.0F;
  float last_s = 0.0F;
  if (!scan.points.empty()) {
    const auto [first, last] =
        std::minmax_element(scan.points.begin(), scan.points.end(),
                            [](const RegisteredPoint& a, const RegisteredPoint& b) {
                              return a.time_offset_s < b.time_offset_s;
                            });
    first_s = first->time_offset_s;
    last_s = last->time_offset_s;
  }
  return SecondsBetween(reference_ns, scan.stamp_ns) + 0.5 * (first_s + last_s);
}

/// Metres per second around scan i, from the neighbours' mid-scan positions.
Eigen::Vector3d VelocityAround(const std::vector<RegisteredScan>& scans,
                               const std::vector<double>& mid_times_s, int i) {
  const int before = std::max(0, i - 1);
  const int after = std::min(static_cast<int>(scans.size()) - 1, i + 1);
  const double elapsed_s = mid_times_s[after] - mid_times_s[before];
  if (elapsed_s <= 0.0) return Eigen::Vector3d::Zero();
  return (scans[after].lidar_in_map_m - scans[before].lidar_in_map_m) / elapsed_s;
}

/// Numbers the voxels of the smallest box around the given ones, in the order of their keys.
class VoxelBox {
 public:
  explicit VoxelBox(const std::vector<std::uint64_t>& keys) {
    std::array<std::uint64_t, 3> last{};
    first_.fill(kMask);
    for (const std::uint64_t key : keys) {
      for (int axis = 0; axis < 3; ++axis) {
        first_[axis] = std::min(first_[axis], Coordinate(key, axis));
        last[axis] = std::max(last[axis], Coordinate(key, axis));
      }
    }
    if (keys.empty()) first_ = last;
    for (int axis = 0; axis < 3; ++axis) size_[axis] = last[axis] - first_[axis] + 1;
  }

  /// At most 2^63.
  std::uint64_t num_voxels() const { return size_[0] * size_[1] * size_[2]; }
  std::uint64_t Number(std::uint64_t key) const {
    const auto offset = [&](int axis) { return Coordinate(key, axis) - first_[axis]; };
    return (offset(0) * size_[1] + offset(1)) * size_[2] + offset(2);
  }

 private:
  static constexpr std::uint64_t kMask = (1 << 21) - 1;
  static std::uint64_t Coordinate(std::uint64_t key, int axis) {
    return key >> (42 - 21 * axis) & kMask;
  }

  std::array<std::uint64_t, 3> first_;
  std::array<std::uint64_t, 3> size_;
};

/// Sorts by the upper 32 bits, whose values are below `limit`, and leaves equals in their order:
/// there are few different values for millions of entries, which a counting sort, digit by digit,
/// puts in order several times faster than comparing.
void SortByUpperHalf(std::uint64_t limit, std::vector<std::uint64_t>* entries) {
  constexpr int kDigitBits = 11;
  constexpr std::uint64_t kDigitMask = (1 << kDigitBits) - 1;
  std::vector<std::uint64_t> sorted(entries->size());
  for (int shift = 32; shift < 64 && (limit - 1) >> (shift - 32) > 0; shift += kDigitBits) {
    std::array<std::size_t, kDigitMask + 2> begin{};
    for (const std::uint64_t entry : *entries) ++begin[(entry >> shift & kDigitMask) + 1];
    for (std::size_t digit = 1; digit < begin.size(); ++digit) begin[digit] += begin[digit - 1];
    for (const std::uint64_t entry : *entries) sorted[begin[entry >> shift & kDigitMask]++] = entry;
    std::swap(*entries, sorted);
  }
}

/// Places of the keys in their ascending order; equal keys stay in theirs.
std::vector<std::uint32_t> SortedByKey(const std::vector<std::uint64_t>& keys) {
  const VoxelBox box(keys);
  std::vector<std::uint32_t> order(keys.size());
  if (box.num_voxels() > std::numeric_limits<std::uint32_t>::max()) {
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = static_cast<std::uint32_t>(i);
    tbb::parallel_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
      return keys[a] != keys[b] ? keys[a] < keys[b] : a < b;
    });
    return order;
  }
  std::vector<std::uint64_t> entries(keys.size());
  for (std::size_t i = 0; i < keys.size(); ++i) entries[i] = box.Number(keys[i]) << 32 | i;
  SortByUpperHalf(box.num_voxels(), &entries);
  for (std::size_t i = 0; i < order.size(); ++i) {
    order[i] = static_cast<std::uint32_t>(entries[i] & 0xffffffffU);
  }
  return order;
}

}  // namespace

std::vector<LidarReturn> CollectReturns(const std::vector<RegisteredScan>& scans,
                                        double min_range_m) {
  const int num_scans = static_cast<int>(scans.size());
  std::vector<double> mid_times_s(num_scans);
  tbb::parallel_for(0, num_scans,
                    [&](int i) { mid_times_s[i] = MidScanTime(scans[i], scans[0].stamp_ns); });
  std::vector<std::vector<LidarReturn>> of_scan(num_scans);
  tbb::parallel_for(0, num_scans, [&](int i) {
    const Eigen::Vector3d velocity = VelocityAround(scans, mid_times_s, i);
    const double stamp_s = SecondsBetween(scans[0].stamp_ns, scans[i].stamp_ns);
    of_scan[i].reserve(scans[i].points.size());
    for (const RegisteredPoint& point : scans[i].points) {
      LidarReturn scene_point;
      scene_point.position_m = point.position_in_map_m;
      const double since_mid_s = stamp_s + point.time_offset_s - mid_times_s[i];
      scene_point.origin_m = (scans[i].lidar_in_map_m + since_mid_s * velocity).cast<float>();
      scene_point.intensity = point.intensity;
      scene_point.scan = i;
      const float range_m = (scene_point.position_m - scene_point.origin_m).norm();
      if (!(range_m >= min_range_m)) continue;  // also drops what is not finite
      of_scan[i].push_back(scene_point);
    }
  });
  std::vector<LidarReturn> points;
  std::size_t total = 0;
  for (const auto& scan : of_scan) total += scan.size();
  points.reserve(total);
  for (auto& scan : of_scan) {
    points.insert(points.end(), scan.begin(), scan.end());
    scan = {};
  }
  return points;
}

int VoxelGroups::Find(std::uint64_t key) const {
  const auto found = std::lower_bound(keys.begin(), keys.end(), key);
  if (found == keys.end() || *found != key) return -1;
  return static_cast<int>(found - keys.begin());
}

VoxelGroups GroupByVoxel(const std::vector<LidarReturn>& points, const std::vector<int>& indices,
                         double voxel_size_m) {
  const float inverse_edge = static_cast<float>(1.0 / voxel_size_m);
  std::vector<std::uint64_t> keys(indices.size());
  tbb::parallel_for(std::size_t{0}, indices.size(), [&](std::size_t i) {
    keys[i] = VoxelKey(points[indices[i]].position_m, inverse_edge);
  });
  VoxelGroups groups;
  groups.order.reserve(keys.size());
  for (const std::uint32_t i : SortedByKey(keys)) {
    if (groups.keys.empty() || keys[i] != groups.keys.back()) {
      groups.keys.push_back(keys[i]);
      groups.begin.push_back(static_cast<int>(groups.order.size()));
    }
    groups.order.push_back(indices[i]);
  }
  groups.begin.push_back(static_cast<int>(keys.size()));
  return groups;
}

}  // namespace scenecalib
