#pragma once

#include <sensor_msgs/PointCloud2.h>

#include "scenecalib/base/status.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// Decodes every PointCloud2 layout of docs/ros_api.md. InvalidArgument naming what is wrong with
/// the message, e.g. a field that lies outside the point or no per-point time where none is
/// allowed.
Result<LidarScan> DecodeScan(const sensor_msgs::PointCloud2& message, const LidarConfig& config);

}  // namespace scenecalib
