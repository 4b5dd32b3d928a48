#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/sensor/measurements.h"

namespace scenecalib {

/// A lidar return as it was measured: in the lidar frame at its own time.
struct SweepPoint {
  Eigen::Vector3f position_in_lidar_m = Eigen::Vector3f::Zero();
  float seconds_from_mid = 0.0F;
};

/// The part of a scan that the odometry works on.
struct SweepSamples {
  Timestamp stamp_ns = 0;
  Timestamp first_ns = 0;  ///< of all returns, whatever their range
  Timestamp last_ns = 0;
  Timestamp mid_ns = 0;
  int num_in_range = 0;               ///< returns between the range limits
  std::vector<SweepPoint> points;     ///< one per dense voxel: what enters the map
  std::vector<std::uint32_t> sparse;  ///< of points, one per sparse voxel: what is registered

  double DurationS() const { return SecondsBetween(first_ns, last_ns); }
};

struct SweepSampling {
  double min_range_m = 0.0;
  double max_range_m = 0.0;
  double dense_voxel_m = 0.0;
  double sparse_voxel_m = 0.0;
};

/// Keeps the first return of each voxel in the scan's order, before deskewing: the voxel grid has
/// no need of exact positions, and only a fraction of the points has to be moved later.
SweepSamples SampleSweep(const LidarScan& scan, const SweepSampling& sampling);

}  // namespace scenecalib
