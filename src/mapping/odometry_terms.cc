#include "odometry_terms.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kMinSigma = 0.005;   // m/s
constexpr double kScaleSigma = 0.03;  // of the prior on the scale error
constexpr double kCorrelationTime_s = 1.0;
constexpr double kRobustScale = 3.0;    // of Huber's weight, in sigmas
constexpr double kMaxInterval_s = 0.3;  // a longer one is a gap

}  // namespace

OdometryTerms::OdometryTerms(const MotionPrior& prior, const PoseSpline& spline, bool use)
    : lidar_from_body_(prior.lidar_from_body()) {
  if (!use) return;
  const OdometrySample* from = nullptr;
  for (const OdometrySample& to : prior.odometry()) {
    if (to.stamp_ns < spline.start_ns() || to.stamp_ns > spline.end_ns()) continue;
    if (from != nullptr) {
      const double interval_s = SecondsBetween(from->stamp_ns, to.stamp_ns);
      if (interval_s < spline.knot_interval_s()) continue;
      if (interval_s <= kMaxInterval_s) {
        const Rigid3 motion = from->odom_from_body.Inverse() * to.odom_from_body;
        // As seen from the middle of the interval.
        const Eigen::Quaterniond middle_from_start = ExpSo3(-0.5 * LogSo3(motion.rotation));
        samples_.push_back({SecondsBetween(spline.start_ns(), from->stamp_ns) + 0.5 * interval_s,
                            interval_s, middle_from_start * motion.translation / interval_s});
      }
    }
    from = &to;
  }
}

OdometryTerms::Prediction OdometryTerms::Predict(const PoseSpline& spline, double seconds) const {
  const SplineState state = spline.StateAt(seconds);
  const PoseSpline::Basis basis = spline.BasisAt(seconds);
  const Eigen::Matrix3d map_from_lidar = state.map_from_lidar.RotationMatrix();
  Prediction p;
  for (int j = 0; j < 4; ++j) {
    p.lidar_velocity_in_map_m_s +=
        basis.velocity[j] * spline.controls()[basis.first + j].translation;
  }
  p.arm_in_map = map_from_lidar * lidar_from_body_.translation;
  p.body_velocity_in_map_m_s =
      p.lidar_velocity_in_map_m_s +
      map_from_lidar * state.angular_velocity_in_lidar.cross(lidar_from_body_.translation);
  p.body_from_map = lidar_from_body_.RotationMatrix().transpose() * map_from_lidar.transpose();
  return p;
}

Eigen::Vector3d OdometryTerms::Residual(const Sample& sample, const Prediction& p) const {
  return sample.velocity_in_body_m_s -
         (1.0 + scale_error_) * p.body_from_map * p.body_velocity_in_map_m_s;
}

void OdometryTerms::UpdateSigma(const PoseSpline& spline) {
  if (samples_.empty()) return;
  std::vector<double> magnitudes;
  for (const Sample& sample : samples_) {
    const Eigen::Vector3d residual = Residual(sample, Predict(spline, sample.seconds)).cwiseAbs();
    magnitudes.insert(magnitudes.end(), residual.data(), residual.data() + 3);
  }
  const auto middle = magnitudes.begin() + static_cast<std::ptrdiff_t>(magnitudes.size() / 2);
  std::nth_element(magnitudes.begin(), middle, magnitudes.end());
  sigma_m_s_ = std::max(1.4826 * *middle, kMinSigma);
}

void OdometryTerms::AddTo(const PoseSpline& spline, DataSubset subset,
                          RefinementSystem* system) const {
  for (std::size_t i = 0; i < samples_.size(); ++i) {
    if (subset != DataSubset::kAll && (i % 2 == 0) != (subset == DataSubset::kEven)) continue;
    const Sample& sample = samples_[i];
    const Prediction p = Predict(spline, sample.seconds);
    const PoseSpline::Basis basis = spline.BasisAt(sample.seconds);
    const Eigen::Matrix3d scaled = (1.0 + scale_error_) * p.body_from_map;
    std::array<Eigen::Matrix<double, 3, RefinementSystem::kPose>, 4> pose;
    for (int j = 0; j < 4; ++j) {
      pose[j] << -basis.velocity[j] * scaled,
          scaled * (basis.velocity[j] * Hat(p.arm_in_map) -
                    basis.weight[j] * Hat(p.lidar_velocity_in_map_m_s));
    }
    RefinementSystem::GlobalJacobian global = RefinementSystem::GlobalJacobian::Zero();
    global.col(RefinementSystem::kOdometryScale) = -p.body_from_map * p.body_velocity_in_map_m_s;
    const Eigen::Vector3d residual = Residual(sample, p);
    const double share = std::min(sample.interval_s / kCorrelationTime_s, 1.0);
    Eigen::Vector3d weight;
    for (int axis = 0; axis < 3; ++axis) {
      const double ratio = std::abs(residual[axis]) / (kRobustScale * sigma_m_s_);
      weight[axis] = share / (sigma_m_s_ * sigma_m_s_ * std::max(1.0, ratio));
    }
    system->AddResidual(basis.first, pose, global, residual, weight);
  }
  system->AddPrior(system->global_offset() + RefinementSystem::kOdometryScale, scale_error_,
                   std::pow(kScaleSigma, -2));
}

double OdometryTerms::ScaleSigma(const PoseSpline& spline,
                                 const DegenerateDirections& degenerate) const {
  double information = std::pow(kScaleSigma, -2);
  for (const Sample& sample : samples_) {
    const Prediction p = Predict(spline, sample.seconds);
    const Eigen::Vector3d seen = degenerate.Projection(sample.seconds) * p.body_velocity_in_map_m_s;
    information += std::min(sample.interval_s / kCorrelationTime_s, 1.0) * seen.squaredNorm() /
                   (sigma_m_s_ * sigma_m_s_);
  }
  return 1.0 / std::sqrt(information);
}

void OdometryTerms::Update(const RefinementSystem::Globals& step) {
  scale_error_ += step[RefinementSystem::kOdometryScale];
}

void OdometryTerms::Report(RefinementResult* result) const {
  if (samples_.empty()) return;
  result->odometry_scale_error = scale_error_;
  result->odometry_sigma_m_s = sigma_m_s_;
}

}  // namespace scenecalib
