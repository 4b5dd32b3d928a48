#pragma once

#include <geometry_msgs/Pose.h>
#include <geometry_msgs/Transform.h>
#include <nav_msgs/Odometry.h>
#include <ros/time.h>
#include <sensor_msgs/Imu.h>

#include "scenecalib/base/status.h"
#include "scenecalib/base/timestamp.h"
#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/sensor/measurements.h"

namespace scenecalib {

inline Timestamp FromRosTime(const ros::Time& time) {
  return static_cast<Timestamp>(time.toNSec());
}
/// Stamps before 1970 become zero: ROS times are not negative.
ros::Time ToRosTime(Timestamp stamp_ns);

geometry_msgs::Pose ToPoseMessage(const Rigid3& target_from_source);
geometry_msgs::Transform ToTransformMessage(const Rigid3& target_from_source);
/// InvalidArgument when a number is not finite or the quaternion is not near unit length.
Result<Rigid3> FromPoseMessage(const geometry_msgs::Pose& pose);

/// InvalidArgument when a number is not finite.
Result<ImuSample> FromMessage(const sensor_msgs::Imu& message);
Result<OdometrySample> FromMessage(const nav_msgs::Odometry& message);

}  // namespace scenecalib
