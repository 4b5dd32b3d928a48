#include "scenecalib/ros/recording_writer.h"

#include <cv_bridge/cv_bridge.h>
#include <nav_msgs/Odometry.h>
#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/PointCloud2.h>
#include <sensor_msgs/image_encodings.h>

#include <cstring>
#include <exception>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "scenecalib/ros/message_conversion.h"

namespace scenecalib {
namespace {

constexpr int kJpegQuality = 95;

sensor_msgs::PointField MakeField(const char* name, std::uint32_t offset, std::uint8_t type) {
  sensor_msgs::PointField field;
  field.name = name;
  field.offset = offset;
  field.datatype = type;
  field.count = 1;
  return field;
}

sensor_msgs::PointCloud2 ToCloud(const LidarScan& scan, const std::string& frame_id) {
  constexpr std::uint32_t kStep = 22;
  sensor_msgs::PointCloud2 cloud;
  cloud.header.stamp = ToRosTime(scan.stamp_ns);
  cloud.header.frame_id = frame_id;
  cloud.height = 1;
  cloud.width = static_cast<std::uint32_t>(scan.points.size());
  using Field = sensor_msgs::PointField;
  cloud.fields = {MakeField("x", 0, Field::FLOAT32),    MakeField("y", 4, Field::FLOAT32),
                  MakeField("z", 8, Field::FLOAT32),    MakeField("intensity", 12, Field::FLOAT32),
                  MakeField("ring", 16, Field::UINT16), MakeField("time", 18, Field::FLOAT32)};
  cloud.point_step = kStep;
  cloud.row_step = kStep * cloud.width;
  cloud.is_dense = 1;
  cloud.data.resize(cloud.row_step);
  std::uint8_t* at = cloud.data.data();
  for (const LidarPoint& point : scan.points) {
    std::memcpy(at, point.position_in_lidar_m.data(), 12);
    std::memcpy(at + 12, &point.intensity, 4);
    std::memcpy(at + 16, &point.ring, 2);
    std::memcpy(at + 18, &point.time_offset_s, 4);
    at += kStep;
  }
  return cloud;
}

sensor_msgs::Imu ToImu(const ImuSample& sample) {
  sensor_msgs::Imu message;
  message.header.stamp = ToRosTime(sample.stamp_ns);
  message.header.frame_id = "imu";
  message.angular_velocity.x = sample.angular_velocity_rad_s.x();
  message.angular_velocity.y = sample.angular_velocity_rad_s.y();
  message.angular_velocity.z = sample.angular_velocity_rad_s.z();
  message.linear_acceleration.x = sample.linear_acceleration_m_s2.x();
  message.linear_acceleration.y = sample.linear_acceleration_m_s2.y();
  message.linear_acceleration.z = sample.linear_acceleration_m_s2.z();
  message.orientation.w = 1.0;
  message.orientation_covariance[0] = -1.0;  // there is no orientation (sensor_msgs/Imu)
  return message;
}

nav_msgs::Odometry ToOdometry(const OdometrySample& sample) {
  nav_msgs::Odometry message;
  message.header.stamp = ToRosTime(sample.stamp_ns);
  message.header.frame_id = "odom";
  message.child_frame_id = "body";
  message.pose.pose = ToPoseMessage(sample.odom_from_body);
  return message;
}

/// None for f-theta, which CameraInfo has no name for.
std::optional<sensor_msgs::CameraInfo> ToInfo(const CameraConfig& camera) {
  const CameraIntrinsics intrinsics = camera.model->intrinsics();
  if (intrinsics.focal_px.size() != 2) return std::nullopt;
  sensor_msgs::CameraInfo info;
  info.header.frame_id = camera.frame_id;
  info.width = static_cast<std::uint32_t>(intrinsics.width_px);
  info.height = static_cast<std::uint32_t>(intrinsics.height_px);
  info.distortion_model = intrinsics.model;
  info.D = intrinsics.distortion;
  const double fx = intrinsics.focal_px[0];
  const double fy = intrinsics.focal_px[1];
  const double cx = intrinsics.principal_point_px.x();
  const double cy = intrinsics.principal_point_px.y();
  info.K = {fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0};
  info.R = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
  info.P = {fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0};
  return info;
}

bool EndsWith(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

void WriteImage(const Simulator& simulator, const ScheduledMeasurement& item, rosbag::Bag* bag) {
  const CameraConfig& camera = simulator.true_rig().cameras[static_cast<std::size_t>(item.camera)];
  const cv::Mat pixels = simulator.RenderImage(item.camera, item.index);
  const ros::Time receipt = ToRosTime(item.arrival_ns);
  std_msgs::Header header;
  header.stamp = ToRosTime(item.stamp_ns);
  header.frame_id = camera.frame_id;
  if (EndsWith(camera.image_topic, "/compressed")) {
    sensor_msgs::CompressedImage message;
    message.header = header;
    message.format = "jpeg";
    cv::imencode(".jpg", pixels, message.data, {cv::IMWRITE_JPEG_QUALITY, kJpegQuality});
    bag->write(camera.image_topic, receipt, message);
  } else {
    const char* encoding = pixels.channels() == 3 ? "bgr8" : "mono8";
    bag->write(camera.image_topic, receipt,
               *cv_bridge::CvImage(header, encoding, pixels).toImageMsg());
  }
  std::optional<sensor_msgs::CameraInfo> info;
  if (camera.camera_info_topic) info = ToInfo(camera);
  if (!info) return;
  info->header = header;
  bag->write(*camera.camera_info_topic, receipt, *info);
}

void WriteMeasurement(const Simulator& simulator, const ScheduledMeasurement& item,
                      rosbag::Bag* bag) {
  const Rig& rig = simulator.true_rig();
  const ros::Time receipt = ToRosTime(item.arrival_ns);
  switch (item.kind) {
    case MeasurementKind::kScan:
      bag->write(rig.lidar.topic, receipt,
                 ToCloud(simulator.CastScan(item.index), rig.lidar.frame_id));
      break;
    case MeasurementKind::kImu:
      bag->write(rig.imu->topic, receipt, ToImu(simulator.Imu(item.index)));
      break;
    case MeasurementKind::kOdometry:
      bag->write(rig.odometry->topic, receipt, ToOdometry(simulator.Odometry(item.index)));
      break;
    case MeasurementKind::kImage:
      WriteImage(simulator, item, bag);
      break;
  }
}

}  // namespace

Status WriteRecording(const Simulator& simulator, const std::string& path,
                      const ProgressCallback& progress) {
  try {
    rosbag::Bag bag(path, rosbag::bagmode::Write);
    bag.setCompression(rosbag::compression::LZ4);
    const std::vector<ScheduledMeasurement>& schedule = simulator.schedule();
    for (std::size_t i = 0; i < schedule.size(); ++i) {
      WriteMeasurement(simulator, schedule[i], &bag);
      if (!ReportProgress(progress, "simulating",
                          static_cast<double>(i + 1) / static_cast<double>(schedule.size()))) {
        return Status::Cancelled("stopped while simulating " + path);
      }
    }
    bag.close();
  } catch (const std::exception& error) {
    return Status::Unavailable("cannot write " + path + ": " + error.what());
  }
  return Status::Ok();
}

}  // namespace scenecalib
