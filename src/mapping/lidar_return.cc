#include "lidar_return.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
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
  std::vector<std::pair<std::uint64_t, int>> keyed(indices.size());
  tbb::parallel_for(std::size_t{0}, indices.size(), [&](std::size_t i) {
    keyed[i] = {VoxelKey(points[indices[i]].position_m, inverse_edge), indices[i]};
  });
  // Key and index together are unique: an unstable sort has one result.
  tbb::parallel_sort(keyed.begin(), keyed.end());
  VoxelGroups groups;
  groups.order.resize(keyed.size());
  for (std::size_t i = 0; i < keyed.size(); ++i) {
    if (i == 0 || keyed[i].first != keyed[i - 1].first) {
      groups.keys.push_back(keyed[i].first);
      groups.begin.push_back(static_cast<int>(i));
    }
    groups.order[i] = keyed[i].second;
  }
  groups.begin.push_back(static_cast<int>(keyed.size()));
  return groups;
}

}  // namespace scenecalib
