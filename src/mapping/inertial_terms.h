#pragma once

#include <Eigen/Core>
#include <vector>

#include "refinement_system.h"
#include "scenecalib/mapping/motion_prior.h"
#include "scenecalib/mapping/pose_spline.h"
#include "scenecalib/mapping/trajectory_refiner.h"

namespace scenecalib {

/// Gyroscope and accelerometer in the refinement: their samples against the spline's derivatives,
/// with constant biases and gravity as unknowns and noise levels taken from the residuals.
class InertialTerms {
 public:
  InertialTerms(const MotionPrior& prior, const PoseSpline& spline, bool use_accelerometer);

  /// Noise levels from the residuals against the current trajectory.
  void UpdateSigmas(const PoseSpline& spline);
  void AddTo(const PoseSpline& spline, DataSubset subset, RefinementSystem* system) const;
  /// Adds a solver's step to biases and gravity.
  void Update(const RefinementSystem::Globals& step);
  void Report(RefinementResult* result) const;

 private:
  struct Sample {
    double seconds = 0.0;
    Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();
    Eigen::Vector3d specific_force = Eigen::Vector3d::Zero();
  };
  /// Predicted minus nothing: what the spline says at a sample.
  struct Prediction {
    Eigen::Matrix3d imu_from_map = Eigen::Matrix3d::Identity();
    Eigen::Vector3d arm_in_map = Eigen::Vector3d::Zero();  ///< lidar to IMU
    Eigen::Vector3d angular_velocity_in_imu = Eigen::Vector3d::Zero();
    Eigen::Vector3d acceleration_in_map = Eigen::Vector3d::Zero();  ///< of the IMU
  };
  Prediction Predict(const PoseSpline& spline, double seconds) const;
  Eigen::Vector3d GyroscopeResidual(const Sample& sample, const Prediction& p) const;
  Eigen::Vector3d AccelerometerResidual(const Sample& sample, const Prediction& p) const;

  std::vector<Sample> samples_;
  Rigid3 lidar_from_imu_;
  bool use_accelerometer_ = false;
  bool is_slow_ = false;  ///< fewer samples than knots: residuals tell too little on the noise
  Eigen::Vector3d gyroscope_bias_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d accelerometer_bias_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d gravity_ = Eigen::Vector3d(0.0, 0.0, -9.81);
  double gyroscope_sigma_ = 0.01;
  double accelerometer_sigma_ = 0.5;
};

}  // namespace scenecalib
