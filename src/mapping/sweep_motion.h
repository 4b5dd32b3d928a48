#pragma once

#include <Eigen/Core>
#include <vector>

#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/geometry/trajectory.h"
#include "scenecalib/mapping/motion_prior.h"
#include "sweep_sampler.h"

namespace scenecalib {

/// Velocity of the lidar, in its own frame.
struct LidarVelocity {
  Eigen::Vector3d linear_m_s = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_rad_s = Eigen::Vector3d::Zero();
};

/// Constant velocity between two poses.
LidarVelocity VelocityBetween(const Rigid3& from, const Rigid3& to, double seconds);

/// The lidar's motion during one sweep, lidar(mid) <- lidar(t): what gyroscope and odometry
/// measured, followed by a constant velocity that the registration estimates. Without sensors the
/// velocity is all there is; with them it corrects their bias.
class SweepMotion {
 public:
  SweepMotion(const SweepSamples& samples, const MotionPrior& prior);

  bool used_gyroscope() const { return used_gyroscope_; }
  bool used_odometry() const { return used_odometry_; }
  /// False when all points have one time: then there is no motion to estimate.
  bool has_duration() const { return measured_.size() > 1; }

  const LidarVelocity& correction() const { return correction_; }
  void SetCorrection(const LidarVelocity& correction);

  /// The velocity in the middle of the sweep, measured and corrected.
  LidarVelocity VelocityAtMid() const;

  /// The point's position in lidar(mid).
  Eigen::Vector3d Deskew(const SweepPoint& point) const;

  /// map_from_lidar over the sweep, every 10 ms or denser.
  std::vector<TimedPose> Poses(const Rigid3& map_from_mid) const;

 private:
  struct Step {
    Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
    Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  };
  double SecondsFromMid(std::size_t step) const {
    return first_s_ + static_cast<double>(step) * step_s_;
  }
  Rigid3 MidFromLidar(std::size_t step) const;

  Timestamp first_ns_ = 0;
  double first_s_ = 0.0;  ///< of the first point, from the middle
  double step_s_ = 1.0;
  std::vector<Rigid3> measured_;  ///< at first_s_ + i * step_s_
  std::vector<Step> steps_;       ///< the same, corrected
  LidarVelocity correction_;
  bool used_gyroscope_ = false;
  bool used_odometry_ = false;
};

/// Where the lidar was in the middle of the sweep before.
struct LastSweep {
  Rigid3 map_from_lidar;
  LidarVelocity velocity;
  bool velocity_is_known = false;
  Timestamp mid_ns = 0;
};

/// What is expected of a sweep's pose and motion before its points are looked at, as information on
/// the increments of the registration (see AddTo). Derived in docs/math.md.
class MotionExpectation {
 public:
  using Matrix12d = Eigen::Matrix<double, 12, 12>;
  using Vector12d = Eigen::Matrix<double, 12, 1>;

  MotionExpectation(const LastSweep& last, const SweepSamples& samples, const SweepMotion& motion,
                    const MotionPrior& prior);

  Rigid3 PredictedPose() const { return predicted_; }
  /// The correction to start from.
  LidarVelocity PredictedCorrection() const;

  /// Adds to the normal equations of the increment (translation, rotation, linear velocity, angular
  /// velocity; all along the map's axes, the rotations from the left).
  void AddTo(const Rigid3& map_from_lidar, const LidarVelocity& correction, Matrix12d* hessian,
             Vector12d* gradient) const;

 private:
  void AddTranslation(const Rigid3& pose, const LidarVelocity& correction, Matrix12d* hessian,
                      Vector12d* gradient) const;
  void AddRotation(const Rigid3& pose, const LidarVelocity& correction, Matrix12d* hessian,
                   Vector12d* gradient) const;

  LastSweep last_;
  double seconds_ = 0.0;  ///< between the middles
  Rigid3 predicted_;
  bool has_gyroscope_ = false;
  bool has_odometry_ = false;
  bool estimates_velocity_ = false;
};

}  // namespace scenecalib
