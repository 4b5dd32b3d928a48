#include "scenecalib/ros/point_cloud_conversion.h"

#include "scenecalib/ros/message_conversion.h"
#include "scenecalib/sensor/point_cloud_decoder.h"

namespace scenecalib {

Result<LidarScan> DecodeScan(const sensor_msgs::PointCloud2& message, const LidarConfig& config) {
  PointCloudView view;
  view.stamp_ns = FromRosTime(message.header.stamp);
  for (const sensor_msgs::PointField& field : message.fields) {
    view.fields.push_back({field.name, field.offset, field.datatype, field.count});
  }
  view.width = message.width;
  view.height = message.height;
  view.point_step = message.point_step;
  view.row_step = message.row_step;
  view.is_bigendian = message.is_bigendian != 0;
  view.data = message.data.data();
  view.size = message.data.size();
  return DecodePointCloud(view, config);
}

}  // namespace scenecalib
