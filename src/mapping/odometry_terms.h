#pragma once

#include <Eigen/Core>
#include <vector>

#include "degenerate_directions.h"
#include "refinement_system.h"
#include "scenecalib/mapping/motion_prior.h"
#include "scenecalib/mapping/pose_spline.h"
#include "scenecalib/mapping/trajectory_refiner.h"

namespace scenecalib {

/// Wheel or pose odometry in the refinement: its velocity over short intervals against the spline's
/// derivative, with one scale as an unknown and the noise level taken from the residuals. Its
/// rotation is left out: wherever there is a plane the lidar knows better.
///
/// Errors of odometry (slip, tyres, its own filter) last for seconds. So an interval's weight is
/// that of its share of a second with one independent error, and not one of many independent
/// measurements: where the lidar sees the motion it decides, and where it does not (a tunnel)
/// nothing else speaks.
class OdometryTerms {
 public:
  /// Without any sample unless `use`.
  OdometryTerms(const MotionPrior& prior, const PoseSpline& spline, bool use);

  bool empty() const { return samples_.empty(); }
  /// Noise level from the residuals against the current trajectory.
  void UpdateSigma(const PoseSpline& spline);
  void AddTo(const PoseSpline& spline, DataSubset subset, RefinementSystem* system) const;
  /// Standard deviation of the scale, as far as the times show it at which the lidar sees all of
  /// the motion.
  double ScaleSigma(const PoseSpline& spline, const DegenerateDirections& degenerate) const;
  /// Adds a solver's step to the scale.
  void Update(const RefinementSystem::Globals& step);
  void Report(RefinementResult* result) const;

 private:
  struct Sample {
    double seconds = 0.0;     ///< middle of the interval
    double interval_s = 0.0;  ///< its length
    Eigen::Vector3d velocity_in_body_m_s = Eigen::Vector3d::Zero();
  };
  /// What the spline says of a sample.
  struct Prediction {
    Eigen::Matrix3d body_from_map = Eigen::Matrix3d::Identity();
    Eigen::Vector3d arm_in_map = Eigen::Vector3d::Zero();  ///< lidar to body
    Eigen::Vector3d lidar_velocity_in_map_m_s = Eigen::Vector3d::Zero();
    Eigen::Vector3d body_velocity_in_map_m_s = Eigen::Vector3d::Zero();
  };
  Prediction Predict(const PoseSpline& spline, double seconds) const;
  Eigen::Vector3d Residual(const Sample& sample, const Prediction& p) const;

  std::vector<Sample> samples_;
  Rigid3 lidar_from_body_;
  double scale_error_ = 0.0;  ///< the odometry's velocity over the true one, less 1
  double sigma_m_s_ = 1.0;
};

}  // namespace scenecalib
