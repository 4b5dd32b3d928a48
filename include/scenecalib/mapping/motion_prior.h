#pragma once

#include <deque>
#include <optional>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// What IMU and odometry say about the lidar's motion between two times: a prediction for the
/// registration, never the last word. Keeps time-sorted buffers; samples may come a little out of
/// order, a repeated stamp is dropped.
class MotionPrior {
 public:
  explicit MotionPrior(const Rig& rig);

  void AddImu(const ImuSample& sample);
  void AddOdometry(const OdometrySample& sample);
  void ForgetBefore(Timestamp stamp_ns);
  void Clear();

  /// Rotation lidar(from) <- lidar(to) from the gyroscope. None without an IMU, or where a gap of
  /// more than 0.25 s or a missing end makes the integral a guess.
  std::optional<Eigen::Quaterniond> RotationBetween(Timestamp from_ns, Timestamp to_ns) const;

  /// Motion lidar(from) <- lidar(to) from the odometry. None without samples on both sides.
  std::optional<Rigid3> MotionBetween(Timestamp from_ns, Timestamp to_ns) const;

  /// Identity when the rig has no IMU; imu() is empty then.
  Rigid3 lidar_from_imu() const { return lidar_from_imu_.value_or(Rigid3::Identity()); }
  /// Identity when the rig has no odometry; odometry() is empty then.
  Rigid3 lidar_from_body() const { return lidar_from_body_.value_or(Rigid3::Identity()); }
  const std::deque<ImuSample>& imu() const { return imu_; }
  const std::deque<OdometrySample>& odometry() const { return odometry_; }
  /// Samples refused: not finite, or a stamp that was there already.
  int num_refused() const { return num_refused_; }

 private:
  std::optional<Rigid3> OdometryPoseAt(Timestamp stamp_ns) const;

  std::optional<Rigid3> lidar_from_imu_;
  std::optional<Rigid3> lidar_from_body_;
  std::deque<ImuSample> imu_;
  std::deque<OdometrySample> odometry_;
  int num_refused_ = 0;
};

}  // namespace scenecalib
