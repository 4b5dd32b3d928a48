#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <unordered_map>
#include <vector>

#include "scenecalib/calibration/cross_camera_matching.h"

namespace scenecalib {

/// Radius search over a camera's feature points.
class FeaturePointGrid {
 public:
  FeaturePointGrid(const std::vector<FeaturePoint>& points, double radius_m)
      : points_(points), radius_m_(radius_m) {
    for (std::size_t i = 0; i < points.size(); ++i) {
      cells_[CellOf(points[i].point_in_map_m)].push_back(static_cast<int>(i));
    }
  }

  /// Stamps at which the camera tracked something near the point, each once, in order.
  std::vector<Timestamp> StampsNear(const Eigen::Vector3d& point_in_map_m) const {
    std::vector<Timestamp> stamps;
    const Cell centre = CellOf(point_in_map_m);
    for (int k = 0; k < 27; ++k) {
      const auto cell =
          cells_.find({centre[0] + k / 9 - 1, centre[1] + k / 3 % 3 - 1, centre[2] + k % 3 - 1});
      if (cell == cells_.end()) continue;
      for (const int i : cell->second) {
        if ((points_[i].point_in_map_m - point_in_map_m).norm() > radius_m_) continue;
        stamps.insert(stamps.end(), points_[i].stamps_ns.begin(), points_[i].stamps_ns.end());
      }
    }
    std::sort(stamps.begin(), stamps.end());
    stamps.erase(std::unique(stamps.begin(), stamps.end()), stamps.end());
    return stamps;
  }

 private:
  using Cell = std::array<int, 3>;

  struct CellHash {
    std::size_t operator()(const Cell& cell) const {
      return static_cast<std::size_t>(cell[0]) * 73856093U ^
             static_cast<std::size_t>(cell[1]) * 19349663U ^
             static_cast<std::size_t>(cell[2]) * 83492791U;
    }
  };

  Cell CellOf(const Eigen::Vector3d& point) const {
    return {static_cast<int>(std::floor(point.x() / radius_m_)),
            static_cast<int>(std::floor(point.y() / radius_m_)),
            static_cast<int>(std::floor(point.z() / radius_m_))};
  }

  const std::vector<FeaturePoint>& points_;
  double radius_m_;
  std::unordered_map<Cell, std::vector<int>, CellHash> cells_;
};

}  // namespace scenecalib
