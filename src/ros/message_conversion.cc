#include "scenecalib/ros/message_conversion.h"

#include <algorithm>
#include <cmath>

namespace scenecalib {

ros::Time ToRosTime(Timestamp stamp_ns) {
  ros::Time time;
  time.fromNSec(static_cast<std::uint64_t>(std::max<Timestamp>(0, stamp_ns)));
  return time;
}

geometry_msgs::Pose ToPoseMessage(const Rigid3& target_from_source) {
  geometry_msgs::Pose pose;
  pose.position.x = target_from_source.translation.x();
  pose.position.y = target_from_source.translation.y();
  pose.position.z = target_from_source.translation.z();
  pose.orientation.x = target_from_source.rotation.x();
  pose.orientation.y = target_from_source.rotation.y();
  pose.orientation.z = target_from_source.rotation.z();
  pose.orientation.w = target_from_source.rotation.w();
  return pose;
}

geometry_msgs::Transform ToTransformMessage(const Rigid3& target_from_source) {
  const geometry_msgs::Pose pose = ToPoseMessage(target_from_source);
  geometry_msgs::Transform transform;
  transform.translation.x = pose.position.x;
  transform.translation.y = pose.position.y;
  transform.translation.z = pose.position.z;
  transform.rotation = pose.orientation;
  return transform;
}

Result<Rigid3> FromPoseMessage(const geometry_msgs::Pose& pose) {
  const Eigen::Quaterniond rotation(pose.orientation.w, pose.orientation.x, pose.orientation.y,
                                    pose.orientation.z);
  const Eigen::Vector3d translation(pose.position.x, pose.position.y, pose.position.z);
  if (!translation.allFinite() || !rotation.coeffs().allFinite() ||
      std::abs(rotation.norm() - 1.0) > 1e-2) {
    return Status::InvalidArgument("pose is not finite, or its quaternion is not of unit length");
  }
  return Rigid3(rotation, translation);
}

Result<ImuSample> FromMessage(const sensor_msgs::Imu& message) {
  ImuSample sample;
  sample.stamp_ns = FromRosTime(message.header.stamp);
  sample.angular_velocity_rad_s = {message.angular_velocity.x, message.angular_velocity.y,
                                   message.angular_velocity.z};
  sample.linear_acceleration_m_s2 = {message.linear_acceleration.x, message.linear_acceleration.y,
                                     message.linear_acceleration.z};
  if (!sample.angular_velocity_rad_s.allFinite() || !sample.linear_acceleration_m_s2.allFinite()) {
    return Status::InvalidArgument("IMU sample is not finite");
  }
  return sample;
}

Result<OdometrySample> FromMessage(const nav_msgs::Odometry& message) {
  const Result<Rigid3> odom_from_body = FromPoseMessage(message.pose.pose);
  if (!odom_from_body.ok()) {
    return Status::InvalidArgument("odometry " + odom_from_body.status().message());
  }
  return OdometrySample{FromRosTime(message.header.stamp), *odom_from_body};
}

}  // namespace scenecalib
