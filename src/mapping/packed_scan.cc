#include "scenecalib/mapping/packed_scan.h"

#include <algorithm>
#include <cmath>

namespace scenecalib {
namespace {

constexpr float kLargest = 65535.0F;

/// Values from `lowest` on in steps of `step` as 16 bits.
std::uint16_t Quantize(float value, float lowest, float step) {
  if (!(step > 0.0F) || !std::isfinite(value)) return 0;
  return static_cast<std::uint16_t>(
      std::clamp(std::round((value - lowest) / step), 0.0F, kLargest));
}

}  // namespace

PackedScan::PackedScan(const LidarScan& scan, double min_range_m, double max_range_m)
    : stamp_ns_(scan.stamp_ns), resolution_m_(static_cast<float>(max_range_m / (kZero - 1))) {
  std::vector<const LidarPoint*> kept;
  kept.reserve(scan.points.size());
  for (const LidarPoint& point : scan.points) {
    const double range_m = point.position_in_lidar_m.cast<double>().norm();
    if (range_m >= min_range_m && range_m <= max_range_m) kept.push_back(&point);
  }
  if (kept.empty()) return;
  float last_time_s = kept.front()->time_offset_s;
  first_time_s_ = last_time_s;
  float highest_intensity = 0.0F;
  for (const LidarPoint* point : kept) {
    first_time_s_ = std::min(first_time_s_, point->time_offset_s);
    last_time_s = std::max(last_time_s, point->time_offset_s);
    if (!std::isfinite(point->intensity)) continue;  // a sensor's way to say that it has none
    lowest_intensity_ = std::min(lowest_intensity_, point->intensity);
    highest_intensity = std::max(highest_intensity, point->intensity);
  }
  time_step_s_ = (last_time_s - first_time_s_) / kLargest;
  intensity_step_ = (highest_intensity - lowest_intensity_) / kLargest;
  positions_.reserve(kept.size());
  times_.reserve(kept.size());
  intensities_.reserve(kept.size());
  for (const LidarPoint* point : kept) {
    std::uint64_t packed = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const auto steps =
          static_cast<std::int32_t>(std::lround(point->position_in_lidar_m[axis] / resolution_m_));
      packed = packed << kBits | static_cast<std::uint64_t>(steps + kZero);
    }
    positions_.push_back(packed);
    times_.push_back(Quantize(point->time_offset_s, first_time_s_, time_step_s_));
    intensities_.push_back(Quantize(point->intensity, lowest_intensity_, intensity_step_));
  }
}

}  // namespace scenecalib
