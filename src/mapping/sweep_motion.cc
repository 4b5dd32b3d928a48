#include "sweep_motion.h"

#include <algorithm>
#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kPoseStepS = 0.01;

// Vehicles change their velocity by a random walk of about these densities: 2 m/s^2 and 45 deg/s^2
// (suspension) that hold for a third of a second.
constexpr double kLinearWalk_m2_s3 = 2.5;
constexpr double kAngularWalk_rad2_s3 = 0.3;

// Sensors: what a bias, wheel slip or a body that rolls on its springs leaves open over a sweep.
constexpr double kGyroscopeSigma_rad = 0.003;
constexpr double kGyroscopeBias_rad_s = 0.02;
constexpr double kOdometrySigma_m = 0.02;
constexpr double kOdometrySlip = 0.02;  // of the speed
constexpr double kOdometrySigma_rad = 0.03;
constexpr double kSuspension_rad_s = 0.3;

/// A velocity that nothing is known about yet.
constexpr double kAnySpeed_m_s = 40.0;
constexpr double kAnyRate_rad_s = 2.0;

/// Adds sigma^-2 |a x_i + b x_j + error|^2 / 2 for two 3-blocks of the unknowns.
void AddTerm(const Eigen::Vector3d& error, int i, double a, int j, double b, double sigma,
             MotionExpectation::Matrix12d* hessian, MotionExpectation::Vector12d* gradient) {
  const double information = 1.0 / (sigma * sigma);
  const Eigen::Matrix3d identity = Eigen::Matrix3d::Identity();
  hessian->block<3, 3>(i, i) += information * a * a * identity;
  gradient->segment<3>(i) += information * a * error;
  if (b == 0.0) return;
  hessian->block<3, 3>(j, j) += information * b * b * identity;
  hessian->block<3, 3>(i, j) += information * a * b * identity;
  hessian->block<3, 3>(j, i) += information * a * b * identity;
  gradient->segment<3>(j) += information * b * error;
}

}  // namespace

LidarVelocity VelocityBetween(const Rigid3& from, const Rigid3& to, double seconds) {
  const Rigid3 step = from.Inverse() * to;
  const Eigen::Vector3d turn = LogSo3(step.rotation);
  return {ExpSo3(-0.5 * turn) * step.translation / seconds, turn / seconds};
}

SweepMotion::SweepMotion(const SweepSamples& samples, const MotionPrior& prior)
    : first_ns_(samples.first_ns), first_s_(SecondsBetween(samples.mid_ns, samples.first_ns)) {
  const double duration_s = samples.DurationS();
  const int num_steps = std::max(static_cast<int>(std::ceil(duration_s / kPoseStepS)), 1);
  step_s_ = duration_s > 0.0 ? duration_s / num_steps : 1.0;
  used_gyroscope_ = used_odometry_ = true;
  for (int i = 0; i <= (duration_s > 0.0 ? num_steps : 0); ++i) {
    const Timestamp stamp_ns = AddSeconds(samples.first_ns, i * step_s_);
    const auto odometry = prior.MotionBetween(samples.mid_ns, stamp_ns);
    const auto rotation = prior.RotationBetween(samples.mid_ns, stamp_ns);
    used_odometry_ = used_odometry_ && odometry.has_value();
    used_gyroscope_ = used_gyroscope_ && rotation.has_value();
    Rigid3 motion = odometry.value_or(Rigid3::Identity());
    if (rotation) motion.rotation = *rotation;
    measured_.push_back(motion);
  }
  // A sensor that covers a part of the sweep only would mean two things at once.
  for (Rigid3& motion : measured_) {
    if (!used_odometry_) motion.translation.setZero();
    if (!used_odometry_ && !used_gyroscope_) motion.rotation.setIdentity();
  }
  SetCorrection({});
}

Rigid3 SweepMotion::MidFromLidar(std::size_t step) const {
  const double seconds = has_duration() ? SecondsFromMid(step) : 0.0;
  return Rigid3(ExpSo3(correction_.angular_rad_s * seconds), correction_.linear_m_s * seconds) *
         measured_[step];
}

void SweepMotion::SetCorrection(const LidarVelocity& correction) {
  correction_ = correction;
  steps_.resize(measured_.size());
  for (std::size_t i = 0; i < steps_.size(); ++i) {
    const Rigid3 mid_from_lidar = MidFromLidar(i);
    steps_[i] = {mid_from_lidar.RotationMatrix(), mid_from_lidar.translation};
  }
}

LidarVelocity SweepMotion::VelocityAtMid() const {
  if (!has_duration()) return correction_;
  const std::size_t before = (steps_.size() - 1) / 2;
  const std::size_t from = before > 0 ? before - 1 : 0;
  const std::size_t to = std::min(steps_.size() - 1, steps_.size() - 1 - from);
  const double seconds = SecondsFromMid(to) - SecondsFromMid(from);
  const Rigid3 motion = MidFromLidar(from).Inverse() * MidFromLidar(to);
  return {(steps_[to].translation - steps_[from].translation) / seconds,
          LogSo3(motion.rotation) / seconds};
}

Eigen::Vector3d SweepMotion::Deskew(const SweepPoint& point) const {
  const Eigen::Vector3d position = point.position_in_lidar_m.cast<double>();
  if (!has_duration()) return position;
  const double at = (point.seconds_from_mid - first_s_) / step_s_;
  const auto before = std::min(static_cast<std::size_t>(std::max(at, 0.0)), steps_.size() - 2);
  const double fraction = at - static_cast<double>(before);
  const Step& a = steps_[before];
  const Step& b = steps_[before + 1];
  return (1.0 - fraction) * (a.rotation * position + a.translation) +
         fraction * (b.rotation * position + b.translation);
}

std::vector<TimedPose> SweepMotion::Poses(const Rigid3& map_from_mid) const {
  std::vector<TimedPose> poses;
  for (std::size_t i = 0; i < measured_.size(); ++i) {
    poses.push_back(
        {AddSeconds(first_ns_, static_cast<double>(i) * step_s_), map_from_mid * MidFromLidar(i)});
  }
  return poses;
}

MotionExpectation::MotionExpectation(const LastSweep& last, const SweepSamples& samples,
                                     const SweepMotion& motion, const MotionPrior& prior)
    : last_(last),
      seconds_(SecondsBetween(last.mid_ns, samples.mid_ns)),
      estimates_velocity_(motion.has_duration()) {
  const auto odometry = prior.MotionBetween(last.mid_ns, samples.mid_ns);
  const auto rotation = prior.RotationBetween(last.mid_ns, samples.mid_ns);
  has_odometry_ = odometry.has_value() && motion.used_odometry();
  has_gyroscope_ = rotation.has_value() && motion.used_gyroscope();
  Rigid3 step(ExpSo3(last.velocity.angular_rad_s * seconds_), Eigen::Vector3d::Zero());
  if (has_odometry_) step.rotation = odometry->rotation;
  if (has_gyroscope_) step.rotation = *rotation;
  // A vehicle keeps its velocity in its own, turning frame.
  step.translation =
      0.5 * seconds_ * (last.velocity.linear_m_s + step.rotation * last.velocity.linear_m_s);
  if (has_odometry_) step.translation = odometry->translation;
  predicted_ = last.map_from_lidar * step;
}

LidarVelocity MotionExpectation::PredictedCorrection() const {
  LidarVelocity correction = last_.velocity;
  if (has_odometry_) correction.linear_m_s.setZero();
  if (has_odometry_ || has_gyroscope_) correction.angular_rad_s.setZero();
  return correction;
}

void MotionExpectation::AddTo(const Rigid3& map_from_lidar, const LidarVelocity& correction,
                              Matrix12d* hessian, Vector12d* gradient) const {
  AddTranslation(map_from_lidar, correction, hessian, gradient);
  AddRotation(map_from_lidar, correction, hessian, gradient);
  // Unknowns that nothing speaks of stay where they are.
  hessian->diagonal().array() += 1e-9;
}

void MotionExpectation::AddTranslation(const Rigid3& pose, const LidarVelocity& correction,
                                       Matrix12d* hessian, Vector12d* gradient) const {
  const Eigen::Vector3d from_predicted = pose.translation - predicted_.translation;
  const Eigen::Vector3d velocity = pose.rotation * correction.linear_m_s;
  if (has_odometry_) {
    const double moved_m = (predicted_.translation - last_.map_from_lidar.translation).norm();
    const double slip_m = kOdometrySlip * moved_m;
    AddTerm(from_predicted, 0, 1.0, 0, 0.0, kOdometrySigma_m + slip_m, hessian, gradient);
    AddTerm(velocity, 6, 1.0, 0, 0.0, (kOdometrySigma_m + slip_m) / seconds_, hessian, gradient);
    return;
  }
  const double walk =
      last_.velocity_is_known ? kLinearWalk_m2_s3 : kAnySpeed_m_s * kAnySpeed_m_s / seconds_;
  if (!estimates_velocity_) {
    const double sigma_m = std::sqrt(walk * std::pow(seconds_, 3) / 3.0);
    AddTerm(from_predicted, 0, 1.0, 0, 0.0, sigma_m, hessian, gradient);
    return;
  }
  // White noise on the acceleration: the mean of both velocities leads from pose to pose.
  const Eigen::Vector3d last_velocity = last_.map_from_lidar.rotation * last_.velocity.linear_m_s;
  const Eigen::Vector3d error = pose.translation - last_.map_from_lidar.translation -
                                0.5 * seconds_ * (last_velocity + velocity);
  AddTerm(error, 0, 1.0, 6, -0.5 * seconds_, std::sqrt(walk * std::pow(seconds_, 3) / 12.0),
          hessian, gradient);
  AddTerm(velocity - pose.rotation * last_.velocity.linear_m_s, 6, 1.0, 0, 0.0,
          std::sqrt(walk * seconds_), hessian, gradient);
}

void MotionExpectation::AddRotation(const Rigid3& pose, const LidarVelocity& correction,
                                    Matrix12d* hessian, Vector12d* gradient) const {
  const Eigen::Vector3d from_predicted = LogSo3(pose.rotation * predicted_.rotation.conjugate());
  const Eigen::Vector3d rate = pose.rotation * correction.angular_rad_s;
  if (has_gyroscope_ || has_odometry_) {
    AddTerm(from_predicted, 3, 1.0, 0, 0.0,
            has_gyroscope_ ? kGyroscopeSigma_rad : kOdometrySigma_rad, hessian, gradient);
    AddTerm(rate, 9, 1.0, 0, 0.0, has_gyroscope_ ? kGyroscopeBias_rad_s : kSuspension_rad_s,
            hessian, gradient);
    return;
  }
  const double walk =
      last_.velocity_is_known ? kAngularWalk_rad2_s3 : kAnyRate_rad_s * kAnyRate_rad_s / seconds_;
  if (!estimates_velocity_) {
    const double sigma_rad = std::sqrt(walk * std::pow(seconds_, 3) / 3.0);
    AddTerm(from_predicted, 3, 1.0, 0, 0.0, sigma_rad, hessian, gradient);
    return;
  }
  const Eigen::Vector3d mean_rate = 0.5 * (last_.velocity.angular_rad_s + correction.angular_rad_s);
  const Eigen::Quaterniond expected = last_.map_from_lidar.rotation * ExpSo3(mean_rate * seconds_);
  AddTerm(LogSo3(pose.rotation * expected.conjugate()), 3, 1.0, 9, -0.5 * seconds_,
          std::sqrt(walk * std::pow(seconds_, 3) / 12.0), hessian, gradient);
  AddTerm(rate - pose.rotation * last_.velocity.angular_rad_s, 9, 1.0, 0, 0.0,
          std::sqrt(walk * seconds_), hessian, gradient);
}

}  // namespace scenecalib
