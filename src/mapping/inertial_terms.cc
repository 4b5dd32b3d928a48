#include "inertial_terms.h"

#include <algorithm>
#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kGravityMS2 = 9.81;
constexpr double kMinGyroscopeSigma = 2e-4;      // rad/s, a good tactical unit
constexpr double kSlowGyroscopeSigma = 3e-3;     // rad/s, of a unit with fewer samples than knots
constexpr double kMinAccelerometerSigma = 5e-3;  // m/s^2
constexpr double kRobustScale = 3.0;             // of Huber's weight, in sigmas

/// RMS-like scale of components from their median magnitude.
double RobustSigma(std::vector<double>* magnitudes) {
  if (magnitudes->empty()) return 0.0;
  const auto middle = magnitudes->begin() + static_cast<std::ptrdiff_t>(magnitudes->size() / 2);
  std::nth_element(magnitudes->begin(), middle, magnitudes->end());
  return 1.4826 * *middle;
}

Eigen::Vector3d HuberWeight(const Eigen::Vector3d& residual, double sigma) {
  Eigen::Vector3d weight;
  for (int axis = 0; axis < 3; ++axis) {
    const double ratio = std::abs(residual[axis]) / (kRobustScale * sigma);
    weight[axis] = 1.0 / (sigma * sigma * std::max(1.0, ratio));
  }
  return weight;
}

}  // namespace

InertialTerms::InertialTerms(const MotionPrior& prior, const PoseSpline& spline,
                             bool use_accelerometer)
    : lidar_from_imu_(prior.lidar_from_imu()) {
  for (const ImuSample& imu : prior.imu()) {
    if (imu.stamp_ns < spline.start_ns() || imu.stamp_ns > spline.end_ns()) continue;
    samples_.push_back({SecondsBetween(spline.start_ns(), imu.stamp_ns), imu.angular_velocity_rad_s,
                        imu.linear_acceleration_m_s2});
  }
  const double duration_s = SecondsBetween(spline.start_ns(), spline.end_ns());
  const double per_knot =
      static_cast<double>(samples_.size()) * spline.knot_interval_s() / duration_s;
  is_slow_ = per_knot < 1.5;
  use_accelerometer_ = use_accelerometer && !is_slow_;
  if (use_accelerometer_) {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const Sample& sample : samples_) {
      const Prediction p = Predict(spline, sample.seconds);
      mean += p.acceleration_in_map - p.imu_from_map.transpose() * sample.specific_force;
    }
    gravity_ = kGravityMS2 * mean.normalized();
  }
}

InertialTerms::Prediction InertialTerms::Predict(const PoseSpline& spline, double seconds) const {
  // Angular acceleration by a difference well inside a knot interval.
  const double half_step_s = 0.05 * spline.knot_interval_s();
  const double end_s = SecondsBetween(spline.start_ns(), spline.end_ns());
  const double t = std::clamp(seconds, half_step_s, std::max(end_s - half_step_s, half_step_s));
  const SplineState state = spline.StateAt(seconds);
  const Eigen::Matrix3d map_from_lidar = state.map_from_lidar.RotationMatrix();
  const Eigen::Vector3d turn_rate = state.angular_velocity_in_lidar;
  const Eigen::Vector3d turn_acceleration =
      (spline.StateAt(t + half_step_s).angular_velocity_in_lidar -
       spline.StateAt(t - half_step_s).angular_velocity_in_lidar) /
      (2.0 * half_step_s);
  const Eigen::Vector3d& arm = lidar_from_imu_.translation;
  Prediction p;
  p.imu_from_map = lidar_from_imu_.RotationMatrix().transpose() * map_from_lidar.transpose();
  p.arm_in_map = map_from_lidar * arm;
  p.angular_velocity_in_imu = lidar_from_imu_.rotation.conjugate() * turn_rate;
  p.acceleration_in_map =
      state.acceleration_in_map +
      map_from_lidar * (turn_acceleration.cross(arm) + turn_rate.cross(turn_rate.cross(arm)));
  return p;
}

Eigen::Vector3d InertialTerms::GyroscopeResidual(const Sample& sample, const Prediction& p) const {
  return sample.angular_velocity - gyroscope_bias_ - p.angular_velocity_in_imu;
}

Eigen::Vector3d InertialTerms::AccelerometerResidual(const Sample& sample,
                                                     const Prediction& p) const {
  return sample.specific_force - accelerometer_bias_ -
         p.imu_from_map * (p.acceleration_in_map - gravity_);
}

void InertialTerms::UpdateSigmas(const PoseSpline& spline) {
  if (samples_.empty()) return;
  std::vector<double> gyroscope;
  std::vector<double> accelerometer;
  for (const Sample& sample : samples_) {
    const Prediction p = Predict(spline, sample.seconds);
    const Eigen::Vector3d g = GyroscopeResidual(sample, p).cwiseAbs();
    const Eigen::Vector3d a = AccelerometerResidual(sample, p).cwiseAbs();
    gyroscope.insert(gyroscope.end(), g.data(), g.data() + 3);
    accelerometer.insert(accelerometer.end(), a.data(), a.data() + 3);
  }
  gyroscope_sigma_ =
      std::max(RobustSigma(&gyroscope), is_slow_ ? kSlowGyroscopeSigma : kMinGyroscopeSigma);
  accelerometer_sigma_ = std::max(RobustSigma(&accelerometer), kMinAccelerometerSigma);
}

void InertialTerms::AddTo(const PoseSpline& spline, DataSubset subset,
                          RefinementSystem* system) const {
  constexpr double kGyroscopeBiasSigma = 0.1;      // rad/s
  constexpr double kAccelerometerBiasSigma = 0.3;  // m/s^2
  constexpr double kGravitySigma = 0.05;           // m/s^2, of its magnitude
  for (std::size_t i = 0; i < samples_.size(); ++i) {
    if (subset != DataSubset::kAll && (i % 2 == 0) != (subset == DataSubset::kEven)) continue;
    const Sample& sample = samples_[i];
    const Prediction p = Predict(spline, sample.seconds);
    const PoseSpline::Basis basis = spline.BasisAt(sample.seconds);
    std::array<Eigen::Matrix<double, 3, RefinementSystem::kPose>, 4> pose;
    RefinementSystem::GlobalJacobian global = RefinementSystem::GlobalJacobian::Zero();
    for (int j = 0; j < 4; ++j) {
      pose[j] << Eigen::Matrix3d::Zero(), -basis.velocity[j] * p.imu_from_map;
    }
    global.leftCols<3>() = -Eigen::Matrix3d::Identity();
    const Eigen::Vector3d gyroscope = GyroscopeResidual(sample, p);
    system->AddResidual(basis.first, pose, global, gyroscope,
                        HuberWeight(gyroscope, gyroscope_sigma_));
    if (!use_accelerometer_) continue;
    for (int j = 0; j < 4; ++j) {
      pose[j].leftCols<3>() = -basis.acceleration[j] * p.imu_from_map;
      pose[j].rightCols<3>() =
          p.imu_from_map * (basis.acceleration[j] * Hat(p.arm_in_map) -
                            basis.weight[j] * Hat(p.acceleration_in_map - gravity_));
    }
    global << Eigen::Matrix3d::Zero(), -Eigen::Matrix3d::Identity(), p.imu_from_map,
        Eigen::Vector3d::Zero();
    const Eigen::Vector3d accelerometer = AccelerometerResidual(sample, p);
    system->AddResidual(basis.first, pose, global, accelerometer,
                        HuberWeight(accelerometer, accelerometer_sigma_));
  }
  const int offset = system->global_offset();
  for (int axis = 0; axis < 3; ++axis) {
    system->AddPrior(offset + axis, gyroscope_bias_[axis], std::pow(kGyroscopeBiasSigma, -2));
    system->AddPrior(offset + 3 + axis, accelerometer_bias_[axis],
                     std::pow(kAccelerometerBiasSigma, -2));
    system->AddPrior(offset + 6 + axis, gravity_[axis] - kGravityMS2 * gravity_.normalized()[axis],
                     std::pow(kGravitySigma, -2));
  }
}

void InertialTerms::Update(const RefinementSystem::Globals& step) {
  gyroscope_bias_ += step.head<3>();
  accelerometer_bias_ += step.segment<3>(3);
  gravity_ += step.segment<3>(6);
}

void InertialTerms::Report(RefinementResult* result) const {
  if (samples_.empty()) return;
  result->gyroscope_bias_rad_s = gyroscope_bias_;
  result->gyroscope_sigma_rad_s = gyroscope_sigma_;
  if (!use_accelerometer_) return;
  result->accelerometer_bias_m_s2 = accelerometer_bias_;
  result->gravity_in_map_m_s2 = gravity_;
  result->accelerometer_sigma_m_s2 = accelerometer_sigma_;
}

}  // namespace scenecalib
