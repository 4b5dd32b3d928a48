#include "scenecalib/mapping/lidar_odometry.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <unordered_set>
#include <utility>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kPoseStepS = 0.01;          // of the motion within a sweep
constexpr double kBootstrapResidualM = 2.0;  // the first motion is not known at all
constexpr double kInlierResidualM = 0.15;

/// Information of the prediction: matters only where the scene leaves a direction open.
constexpr double kPredictionSigmaM = 0.5;
constexpr double kPredictionSigmaRad = 0.05;

/// Keeps the first point of each voxel, in the order given.
std::vector<Eigen::Vector3d> DownSample(const std::vector<Eigen::Vector3d>& points,
                                        double voxel_size_m) {
  std::unordered_set<std::uint64_t> seen;
  seen.reserve(points.size());
  std::vector<Eigen::Vector3d> kept;
  for (const Eigen::Vector3d& point : points) {
    if (seen.insert(VoxelKey::Of(point, voxel_size_m)).second) kept.push_back(point);
  }
  return kept;
}

/// Moves a point by the motion at its time, linear between the steps of the motion.
Eigen::Vector3d Deskewed(const std::vector<Rigid3>& mid_from_lidar, double step_s,
                         const Eigen::Vector3d& point, double seconds_from_first) {
  if (mid_from_lidar.size() == 1) return point;
  const double position = seconds_from_first / step_s;
  const auto before =
      std::min(static_cast<std::size_t>(std::max(position, 0.0)), mid_from_lidar.size() - 2);
  const double fraction = position - static_cast<double>(before);
  return (1.0 - fraction) * (mid_from_lidar[before] * point) +
         fraction * (mid_from_lidar[before + 1] * point);
}

}  // namespace

/// A scan on its way through the registration.
struct LidarOdometry::Sweep {
  Timestamp stamp_ns = 0;
  Timestamp first_ns = 0;
  Timestamp last_ns = 0;
  Timestamp mid_ns = 0;
  std::vector<Eigen::Vector3d> raw;        ///< within range, each at its own time
  std::vector<double> seconds_from_first;  ///< of each raw point
  double step_s = kPoseStepS;              ///< between entries of mid_from_lidar
  std::vector<Rigid3> mid_from_lidar;      ///< lidar(mid) <- lidar(first + i step)
  std::vector<Eigen::Vector3d> deskewed;   ///< raw points in lidar(mid)
  std::vector<Eigen::Vector3d> source;     ///< the ones that are registered
  bool used_gyroscope = false;
  bool used_odometry = false;
};

LidarOdometry::LidarOdometry(const OdometryOptions& options)
    : options_(options), map_(options.finest_voxel_size_m) {}

void LidarOdometry::Reset() { *this = LidarOdometry(options_); }

LidarOdometry::Sweep LidarOdometry::Prepare(const LidarScan& scan) const {
  Sweep sweep;
  sweep.stamp_ns = scan.stamp_ns;
  float first_s = std::numeric_limits<float>::max();
  float last_s = std::numeric_limits<float>::lowest();
  for (const LidarPoint& point : scan.points) {
    first_s = std::min(first_s, point.time_offset_s);
    last_s = std::max(last_s, point.time_offset_s);
  }
  if (scan.points.empty()) first_s = last_s = 0.0F;
  sweep.first_ns = AddSeconds(scan.stamp_ns, first_s);
  sweep.last_ns = AddSeconds(scan.stamp_ns, last_s);
  sweep.mid_ns = sweep.first_ns + (sweep.last_ns - sweep.first_ns) / 2;
  sweep.raw.reserve(scan.points.size());
  sweep.seconds_from_first.reserve(scan.points.size());
  for (const LidarPoint& point : scan.points) {
    const Eigen::Vector3d position = point.position_in_lidar_m.cast<double>();
    const double range_m = position.norm();
    // The negated form also drops a range that is not a number.
    if (!(range_m >= options_.min_range_m && range_m <= options_.max_range_m)) continue;
    sweep.raw.push_back(position);
    sweep.seconds_from_first.push_back(point.time_offset_s - first_s);
  }
  return sweep;
}

void LidarOdometry::Deskew(const MotionPrior& prior, Sweep* sweep) const {
  const double duration_s = SecondsBetween(sweep->first_ns, sweep->last_ns);
  const int num_steps = std::max(static_cast<int>(std::ceil(duration_s / kPoseStepS)), 1);
  sweep->step_s = duration_s / num_steps;
  sweep->used_gyroscope = sweep->used_odometry = true;
  sweep->mid_from_lidar.clear();
  for (int i = 0; i <= (duration_s > 0.0 ? num_steps : 0); ++i) {
    const Timestamp stamp_ns = AddSeconds(sweep->first_ns, i * sweep->step_s);
    const double seconds = SecondsBetween(sweep->mid_ns, stamp_ns);
    Rigid3 motion(ExpSo3(angular_velocity_rad_s_ * seconds), velocity_in_lidar_m_s_ * seconds);
    const auto odometry = prior.MotionBetween(sweep->mid_ns, stamp_ns);
    if (odometry) motion = *odometry;
    const auto rotation = prior.RotationBetween(sweep->mid_ns, stamp_ns);
    if (rotation) motion.rotation = *rotation;
    sweep->used_odometry = sweep->used_odometry && odometry.has_value();
    sweep->used_gyroscope = sweep->used_gyroscope && rotation.has_value();
    sweep->mid_from_lidar.push_back(motion);
  }
  sweep->deskewed.resize(sweep->raw.size());
  for (std::size_t i = 0; i < sweep->raw.size(); ++i) {
    sweep->deskewed[i] =
        Deskewed(sweep->mid_from_lidar, sweep->step_s, sweep->raw[i], sweep->seconds_from_first[i]);
  }
  sweep->source = DownSample(sweep->deskewed, options_.source_voxel_size_m);
}

Rigid3 LidarOdometry::Predict(const Sweep& sweep, const MotionPrior& prior) const {
  const double seconds = SecondsBetween(last_mid_ns_, sweep.mid_ns);
  Rigid3 motion(ExpSo3(angular_velocity_rad_s_ * seconds), velocity_in_lidar_m_s_ * seconds);
  const auto odometry = prior.MotionBetween(last_mid_ns_, sweep.mid_ns);
  if (odometry) motion = *odometry;
  const auto rotation = prior.RotationBetween(last_mid_ns_, sweep.mid_ns);
  if (rotation) motion.rotation = *rotation;
  return map_from_last_ * motion;
}

LidarOdometry::Alignment LidarOdometry::Align(const std::vector<Eigen::Vector3d>& points_in_lidar,
                                              const Rigid3& predicted,
                                              double first_residual_m) const {
  using Matrix6d = Eigen::Matrix<double, 6, 6>;
  using Vector6d = Eigen::Matrix<double, 6, 1>;
  Alignment result;
  result.map_from_lidar = predicted;
  double kernel_m = first_residual_m / 3.0;
  const double last_kernel_m = std::min(kInlierResidualM / 3.0, kernel_m);
  for (; result.iterations < options_.max_iterations; ++result.iterations) {
    // While the pose is off by more than a fine voxel only the coarse planes mean anything.
    const int first_level = kernel_m > 0.5 * options_.finest_voxel_size_m ? 2 : 0;
    Rigid3& pose = result.map_from_lidar;
    Matrix6d hessian = Matrix6d::Zero();
    Vector6d gradient = Vector6d::Zero();
    double sum_squares = 0.0;
    result.num_matched = result.num_inliers = 0;
    for (const Eigen::Vector3d& point : points_in_lidar) {
      const Eigen::Vector3d arm = pose.rotation * point;
      PlaneMatch match;
      if (!map_.Match(arm + pose.translation, first_level, &match)) continue;
      if (std::abs(match.distance_m) > 6.0 * kernel_m) continue;
      ++result.num_matched;
      if (std::abs(match.distance_m) < kInlierResidualM) {
        ++result.num_inliers;
        sum_squares += match.distance_m * match.distance_m;
      }
      // Geman-McClure on the distance, and less weight for thick planes.
      const double ratio = match.distance_m / kernel_m;
      const double robust = 1.0 / ((1.0 + ratio * ratio) * (1.0 + ratio * ratio));
      const double weight = robust / (0.02 * 0.02 + match.sigma_m * match.sigma_m);
      Vector6d jacobian;
      jacobian << match.normal, arm.cross(match.normal);
      hessian.selfadjointView<Eigen::Lower>().rankUpdate(jacobian, weight);
      gradient += weight * match.distance_m * jacobian;
    }
    result.rms_m = std::sqrt(sum_squares / std::max(result.num_inliers, 1));
    Vector6d prior_information;
    prior_information << Eigen::Vector3d::Constant(1.0 / (kPredictionSigmaM * kPredictionSigmaM)),
        Eigen::Vector3d::Constant(1.0 / (kPredictionSigmaRad * kPredictionSigmaRad));
    Vector6d deviation;
    deviation << pose.translation - predicted.translation,
        LogSo3(pose.rotation * predicted.rotation.conjugate());
    hessian.diagonal() += prior_information;
    gradient += prior_information.cwiseProduct(deviation);
    const Vector6d step = -hessian.selfadjointView<Eigen::Lower>().ldlt().solve(gradient);
    // Rigid3's constructor normalises: products of many small steps stay rotations.
    pose = Rigid3(ExpSo3(step.tail<3>()) * pose.rotation, pose.translation + step.head<3>());
    const bool small = step.head<3>().norm() < 5e-4 && step.tail<3>().norm() < 3e-5;
    if (small && kernel_m <= last_kernel_m) {
      result.converged = true;
      break;
    }
    kernel_m = std::max(0.7 * kernel_m, last_kernel_m);
  }
  return result;
}

bool LidarOdometry::IsLost(const Alignment& alignment, std::size_t num_source) const {
  const double num_matched = std::max(alignment.num_matched, 1);
  return alignment.num_inliers < options_.min_points / 4 ||
         alignment.num_inliers < options_.min_inlier_ratio * num_matched ||
         alignment.num_inliers < 0.15 * static_cast<double>(num_source);
}

void LidarOdometry::UpdateVelocity(const Rigid3& map_from_lidar, Timestamp mid_ns) {
  const double seconds = SecondsBetween(last_mid_ns_, mid_ns);
  const Eigen::Quaterniond rotation = map_from_last_.rotation.conjugate() * map_from_lidar.rotation;
  angular_velocity_rad_s_ = LogSo3(rotation) / seconds;
  velocity_in_lidar_m_s_ = map_from_lidar.rotation.conjugate() *
                           (map_from_lidar.translation - map_from_last_.translation) / seconds;
}

LidarOdometry::Alignment LidarOdometry::AlignWithVelocity(const MotionPrior& prior, Sweep* sweep) {
  constexpr int kMaxPasses = 3;
  constexpr double kStillM = 0.003;  // a change of the deskewing that does not matter any more
  Alignment alignment;
  Rigid3 predicted = Predict(*sweep, prior);
  double residual_m = options_.max_residual_m;
  for (int pass = 0; pass < kMaxPasses; ++pass) {
    const Eigen::Vector3d velocity = velocity_in_lidar_m_s_;
    alignment = Align(sweep->source, predicted, residual_m);
    if (sweep->used_odometry || IsLost(alignment, sweep->source.size())) break;
    UpdateVelocity(alignment.map_from_lidar, sweep->mid_ns);
    const double half_sweep_s = SecondsBetween(sweep->mid_ns, sweep->last_ns);
    if ((velocity_in_lidar_m_s_ - velocity).norm() * half_sweep_s < kStillM) break;
    Deskew(prior, sweep);
    predicted = alignment.map_from_lidar;
    residual_m = 0.5 * options_.max_residual_m;
  }
  return alignment;
}

LidarOdometry::Alignment LidarOdometry::Bootstrap(const MotionPrior& prior, Sweep* sweep) {
  // The first scan was deskewed without knowing the velocity, so the map is as wrong as the second
  // scan: both are deskewed anew with the velocity found between them until it stands still.
  constexpr int kPasses = 5;
  Alignment alignment;
  Rigid3 predicted = Predict(*sweep, prior);
  double residual_m = kBootstrapResidualM;
  for (int pass = 0; pass < kPasses; ++pass) {
    alignment = Align(sweep->source, predicted, residual_m);
    if (first_sweep_->used_odometry || IsLost(alignment, sweep->source.size())) break;
    if (pass + 1 == kPasses) break;
    UpdateVelocity(alignment.map_from_lidar, sweep->mid_ns);
    Deskew(prior, first_sweep_.get());
    Deskew(prior, sweep);
    map_.Clear();
    InsertIntoMap(*first_sweep_, map_from_last_);
    predicted = alignment.map_from_lidar;
    residual_m = options_.max_residual_m;
  }
  return alignment;
}

void LidarOdometry::InsertIntoMap(const Sweep& sweep, const Rigid3& map_from_lidar) {
  std::vector<Eigen::Vector3d> points = DownSample(sweep.deskewed, options_.map_voxel_size_m);
  for (Eigen::Vector3d& point : points) point = map_from_lidar * point;
  map_.Insert(points);
  map_.ForgetBeyond(map_from_lidar.translation, options_.max_range_m);
}

SweepRegistration LidarOdometry::Finish(const Sweep& sweep, const Alignment& alignment) const {
  SweepRegistration registration;
  registration.stamp_ns = sweep.stamp_ns;
  registration.first_point_ns = sweep.first_ns;
  registration.last_point_ns = sweep.last_ns;
  registration.map_from_lidar = alignment.map_from_lidar;
  for (std::size_t i = 0; i < sweep.mid_from_lidar.size(); ++i) {
    registration.poses.push_back({AddSeconds(sweep.first_ns, static_cast<double>(i) * sweep.step_s),
                                  alignment.map_from_lidar * sweep.mid_from_lidar[i]});
  }
  registration.converged = alignment.converged;
  registration.iterations = alignment.iterations;
  registration.num_inliers = alignment.num_inliers;
  registration.rms_m = alignment.rms_m;
  registration.stretch = stretch_;
  registration.used_gyroscope = sweep.used_gyroscope;
  registration.used_odometry = sweep.used_odometry;
  return registration;
}

Result<SweepRegistration> LidarOdometry::Register(const LidarScan& scan, const MotionPrior& prior) {
  Sweep sweep = Prepare(scan);
  if (last_stamp_ns_ != 0 && (scan.stamp_ns <= last_stamp_ns_ || sweep.mid_ns <= last_mid_ns_)) {
    return Status::InvalidArgument("lidar scan " + std::to_string(scan.stamp_ns) +
                                   " ns is not later than the one before it (" +
                                   std::to_string(last_stamp_ns_) + " ns)");
  }
  if (sweep.raw.size() < static_cast<std::size_t>(options_.min_points)) {
    return Status::InvalidArgument("lidar scan " + std::to_string(scan.stamp_ns) + " ns has only " +
                                   std::to_string(sweep.raw.size()) + " points within range, " +
                                   std::to_string(options_.min_points) + " are needed");
  }
  Deskew(prior, &sweep);
  Alignment alignment;
  if (map_.empty()) {
    if (last_stamp_ns_ == 0) {
      const Eigen::Vector3d up = EstimateUpFromGround(sweep.deskewed);
      map_from_last_ = Rigid3(Eigen::Quaterniond::FromTwoVectors(up, Eigen::Vector3d::UnitZ()),
                              Eigen::Vector3d::Zero());
    }
    alignment.map_from_lidar = map_from_last_;
    alignment.converged = true;
    first_sweep_ = std::make_shared<Sweep>(sweep);
    InsertIntoMap(sweep, alignment.map_from_lidar);
  } else {
    alignment = num_registered_ == 1 ? Bootstrap(prior, &sweep) : AlignWithVelocity(prior, &sweep);
    if (IsLost(alignment, sweep.source.size())) {
      alignment.converged = false;
      alignment.map_from_lidar = Predict(sweep, prior);
      ++num_lost_in_a_row_;
    } else {
      alignment.converged = true;
      num_lost_in_a_row_ = 0;
      UpdateVelocity(alignment.map_from_lidar, sweep.mid_ns);
      InsertIntoMap(sweep, alignment.map_from_lidar);
      first_sweep_.reset();
    }
  }
  SweepRegistration registration = Finish(sweep, alignment);
  map_from_last_ = alignment.map_from_lidar;
  last_stamp_ns_ = sweep.stamp_ns;
  last_mid_ns_ = sweep.mid_ns;
  num_registered_ += alignment.converged ? 1 : 0;
  if (num_lost_in_a_row_ >= options_.max_lost_scans) {
    map_.Clear();
    ++stretch_;
    num_registered_ = num_lost_in_a_row_ = 0;
    velocity_in_lidar_m_s_.setZero();
    angular_velocity_rad_s_.setZero();
  }
  return registration;
}

Eigen::Vector3d EstimateUpFromGround(const std::vector<Eigen::Vector3d>& points_in_lidar) {
  constexpr double kMaxRangeM = 20.0;
  constexpr double kMaxTiltRad = 0.35;
  std::vector<Eigen::Vector3d> near;
  std::vector<double> heights;
  for (const Eigen::Vector3d& point : points_in_lidar) {
    if (point.head<2>().norm() > kMaxRangeM || point.z() > 0.0) continue;
    near.push_back(point);
    heights.push_back(point.z());
  }
  if (near.size() < 100) return Eigen::Vector3d::UnitZ();
  // The ground is the lowest large thing below the sensor: start from the median of what lies
  // below it and keep what is close to the plane, closer in every round.
  const auto low = heights.begin() + static_cast<std::ptrdiff_t>(heights.size() / 4);
  std::nth_element(heights.begin(), low, heights.end());
  Eigen::Vector3d plane(0.0, 0.0, *low);  // z = a x + b y + c
  for (const double gate_m : {1.0, 0.6, 0.4, 0.3, 0.2, 0.15, 0.15}) {
    Eigen::Matrix3d normal_matrix = 1e-6 * Eigen::Matrix3d::Identity();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& point : near) {
      const Eigen::Vector3d row(point.x(), point.y(), 1.0);
      if (std::abs(row.dot(plane) - point.z()) > gate_m) continue;
      normal_matrix += row * row.transpose();
      right += row * point.z();
    }
    if (normal_matrix(2, 2) < 50.0) return Eigen::Vector3d::UnitZ();
    plane = normal_matrix.ldlt().solve(right);
  }
  const Eigen::Vector3d up = Eigen::Vector3d(-plane.x(), -plane.y(), 1.0).normalized();
  return std::acos(std::min(up.z(), 1.0)) < kMaxTiltRad ? up : Eigen::Vector3d::UnitZ();
}

}  // namespace scenecalib
