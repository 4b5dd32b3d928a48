#pragma once

#include <Eigen/Core>
#include <vector>

#include "lidar_return.h"

namespace scenecalib {

/// Averaged ground returns with a normal: what the ground's surface is made from.
struct GroundSample {
  Eigen::Vector3f position_m = Eigen::Vector3f::Zero();
  Eigen::Vector3f normal = Eigen::Vector3f::UnitZ();  ///< unit, upwards
  int num_returns = 0;
  bool has_normal = false;  ///< false: too few samples around, the normal is a guess
};

/// Averages the ground in columns. Range noise of 2 cm is mostly along the road at a lidar's
/// grazing angles; a column's mean height is good to millimetres. A column that holds a step (a
/// kerb's face) is cut into slices. Ordered by column.
std::vector<GroundSample> AverageGround(const std::vector<LidarReturn>& points,
                                        const std::vector<PointLabel>& labels,
                                        double column_size_m);

}  // namespace scenecalib
