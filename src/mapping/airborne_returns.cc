#include "airborne_returns.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace scenecalib {
namespace {

constexpr float kMaxRangeM = 10.0F;
constexpr int kNumColumns = 360;  // cells of a degree
constexpr int kNumRows = 180;
constexpr std::size_t kMaxTested = 4000;
constexpr int kMinBeams = 8;  // around a return, to say anything about it

/// Ranges of a scan's returns by direction.
class Directions {
 public:
  explicit Directions(const PackedScan& scan) : cells_(kNumColumns * kNumRows) {
    ranges_m_.reserve(scan.size());
    cell_of_.reserve(scan.size());
    for (std::size_t i = 0; i < scan.size(); ++i) {
      const Eigen::Vector3f p = scan.position_in_lidar_m(i);
      const float range_m = std::max(p.norm(), 1e-3F);
      const float degrees = 180.0F / 3.14159265F;
      const int column = static_cast<int>(std::atan2(p.y(), p.x()) * degrees + 360.0F);
      const int row = static_cast<int>(std::asin(p.z() / range_m) * degrees + 90.0F);
      const int cell = std::clamp(row, 0, kNumRows - 1) * kNumColumns + column % kNumColumns;
      ranges_m_.push_back(range_m);
      cell_of_.push_back(cell);
      cells_[static_cast<std::size_t>(cell)].push_back(range_m);
    }
  }

  float range_m(std::size_t i) const { return ranges_m_[i]; }

  bool IsAirborne(std::size_t i) const {
    const float range_m = ranges_m_[i];
    const float alike_m = std::max(0.3F, 0.05F * range_m);
    const float behind_m = range_m + std::max(1.0F, 0.2F * range_m);
    int num_beams = -1;  // less the return itself
    int num_alike = -1;
    int num_behind = 0;
    const int row = cell_of_[i] / kNumColumns;
    const int column = cell_of_[i] % kNumColumns;
    for (int r = std::max(0, row - 1); r <= std::min(kNumRows - 1, row + 1); ++r) {
      for (int c = column - 1; c <= column + 1; ++c) {
        const int cell = r * kNumColumns + (c + kNumColumns) % kNumColumns;
        for (const float other_m : cells_[static_cast<std::size_t>(cell)]) {
          ++num_beams;
          if (std::abs(other_m - range_m) < alike_m) ++num_alike;
          if (other_m > behind_m) ++num_behind;
        }
      }
    }
    return num_beams >= kMinBeams && 2 * num_behind > num_beams && 5 * num_alike < num_beams;
  }

 private:
  std::vector<float> ranges_m_;
  std::vector<int> cell_of_;
  std::vector<std::vector<float>> cells_;
};

}  // namespace

double AirborneShare(const PackedScan& scan) {
  if (scan.size() == 0) return 0.0;
  const Directions directions(scan);
  std::vector<std::size_t> near;
  for (std::size_t i = 0; i < scan.size(); ++i) {
    if (directions.range_m(i) < kMaxRangeM) near.push_back(i);
  }
  const std::size_t stride = near.size() / kMaxTested + 1;
  std::size_t num_tested = 0;
  std::size_t num_airborne = 0;
  for (std::size_t k = 0; k < near.size(); k += stride) {
    ++num_tested;
    if (directions.IsAirborne(near[k])) ++num_airborne;
  }
  if (num_tested == 0) return 0.0;
  return static_cast<double>(num_airborne) / static_cast<double>(num_tested) *
         static_cast<double>(near.size()) / static_cast<double>(scan.size());
}

}  // namespace scenecalib
