#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// One field of a point, as in sensor_msgs/PointField.
struct PointCloudField {
  std::string name;
  std::uint32_t offset = 0;   ///< bytes from the start of the point
  std::uint8_t datatype = 0;  ///< sensor_msgs/PointField: 1 INT8 ... 7 FLOAT32, 8 FLOAT64
  std::uint32_t count = 1;
};

/// The bytes of a sensor_msgs/PointCloud2 and how they are laid out, without ROS.
struct PointCloudView {
  Timestamp stamp_ns = 0;
  std::vector<PointCloudField> fields;
  std::uint32_t width = 0;
  std::uint32_t height = 1;
  std::uint32_t point_step = 0;  ///< bytes
  std::uint32_t row_step = 0;    ///< bytes
  bool is_bigendian = false;
  const std::uint8_t* data = nullptr;
  std::size_t size = 0;  ///< bytes in data
};

/// Decodes a sweep. Fields may have any order, type and padding; points that are not finite or lie
/// at the origin are dropped.
///
/// Point times, the first rule that holds:
/// - LidarConfig::motion_compensated: every point is at the stamp;
/// - a field `time`, `t`, `timestamp`, `offset_time`, `time_offset` or `time_stamp`: integers are
///   nanoseconds after the stamp; floats are seconds after the stamp, or, beyond 10^6, absolute
///   seconds (beyond 10^14: nanoseconds) on the stamp's clock;
/// - LidarConfig::scan_period_s: the azimuth since the first point tells the share of the period;
///   the direction of rotation is that of the points' order. The sweep begins at the stamp.
///
/// Rings from `ring`, `channel`, `line` or `laser_id`, else from the row of an organised cloud.
/// InvalidArgument, naming what is missing or wrong, for a layout that cannot be decoded;
/// InsufficientData for a cloud without any valid point.
Result<LidarScan> DecodePointCloud(const PointCloudView& cloud, const LidarConfig& config);

}  // namespace scenecalib
