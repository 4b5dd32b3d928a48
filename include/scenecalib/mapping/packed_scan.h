#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/sensor/measurements.h"

namespace scenecalib {

/// A lidar scan as a mapper keeps it: 12 bytes a point, only what lies within the range that counts
/// and without rings. Coordinates are rounded to max_range_m / 2^20 (0.11 mm at 120 m), times to
/// 1/65535 of the sweep, intensities to 1/65535 of the scan's span.
class PackedScan {
 public:
  PackedScan() = default;
  PackedScan(const LidarScan& scan, double min_range_m, double max_range_m);

  Timestamp stamp_ns() const { return stamp_ns_; }
  std::size_t size() const { return positions_.size(); }

  Eigen::Vector3f position_in_lidar_m(std::size_t i) const {
    const std::uint64_t packed = positions_[i];
    return {resolution_m_ * Component(packed >> (2 * kBits)),
            resolution_m_ * Component(packed >> kBits), resolution_m_ * Component(packed)};
  }
  float time_offset_s(std::size_t i) const {
    return first_time_s_ + time_step_s_ * static_cast<float>(times_[i]);
  }
  float intensity(std::size_t i) const {
    return lowest_intensity_ + intensity_step_ * static_cast<float>(intensities_[i]);
  }
  /// Memory held by the points.
  std::size_t num_bytes() const {
    return size() * (sizeof(std::uint64_t) + 2 * sizeof(std::uint16_t));
  }

 private:
  static constexpr int kBits = 21;
  static constexpr std::int32_t kZero = 1 << (kBits - 1);

  static float Component(std::uint64_t bits) {
    constexpr std::uint64_t kMask = (1U << kBits) - 1;
    return static_cast<float>(static_cast<std::int32_t>(bits & kMask) - kZero);
  }

  Timestamp stamp_ns_ = 0;
  float resolution_m_ = 1.0F;
  float first_time_s_ = 0.0F;
  float time_step_s_ = 0.0F;
  float lowest_intensity_ = 0.0F;
  float intensity_step_ = 0.0F;
  std::vector<std::uint64_t> positions_;
  std::vector<std::uint16_t> times_;
  std::vector<std::uint16_t> intensities_;
};

}  // namespace scenecalib
