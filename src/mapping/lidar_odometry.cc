#include "scenecalib/mapping/lidar_odometry.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <utility>

#include "scenecalib/geometry/so3.h"
#include "start_velocity.h"
#include "sweep_alignment.h"
#include "sweep_motion.h"
#include "sweep_sampler.h"

namespace scenecalib {
namespace {

constexpr double kBootstrapKernelM = 0.7;  // the first motion is not known at all
constexpr double kLeverM = 10.0;           // typical distance of a point: makes rotations lengths

SweepSampling Sampling(const OdometryOptions& options) {
  return {options.min_range_m, options.max_range_m, options.map_voxel_size_m,
          options.source_voxel_size_m};
}

AlignmentOptions Alignment(const OdometryOptions& options, double first_kernel_m) {
  AlignmentOptions alignment;
  alignment.max_iterations = options.max_iterations;
  alignment.finest_voxel_size_m = options.finest_voxel_size_m;
  alignment.first_kernel_m = first_kernel_m;
  return alignment;
}

std::string Name(Timestamp stamp_ns) { return "lidar scan " + std::to_string(stamp_ns) + " ns"; }

/// Of the points that were to be registered.
double InlierShare(const AlignedSweep& aligned, std::size_t num_source) {
  return aligned.num_inliers / std::max(static_cast<double>(num_source), 1.0);
}

std::string Seconds(double seconds) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.2f s", seconds);
  return text;
}

}  // namespace

/// A scan on its way through the registration.
struct LidarOdometry::Sweep {
  Sweep(SweepSamples samples_in, const MotionPrior& prior)
      : samples(std::move(samples_in)), motion(samples, prior) {
    source.reserve(samples.sparse.size());
    for (const std::uint32_t i : samples.sparse) source.push_back(samples.points[i]);
  }
  SweepSamples samples;
  std::vector<SweepPoint> source;  ///< the points that are registered
  SweepMotion motion;
};

struct LidarOdometry::Placement {
  AlignedSweep aligned;
  LidarVelocity velocity;
  bool lost = false;
};

LidarOdometry::LidarOdometry(const OdometryOptions& options)
    : options_(options), map_(options.finest_voxel_size_m) {}

void LidarOdometry::Reset() { *this = LidarOdometry(options_); }

Status LidarOdometry::CheckStamp(Timestamp stamp_ns) {
  if (last_stamp_ns_ == 0) return Status::Ok();
  const Timestamp refused_ns = std::exchange(refused_stamp_ns_, 0);
  if (stamp_ns <= last_stamp_ns_) {
    return Status::InvalidArgument(Name(stamp_ns) + " is not later than the one before it (" +
                                   std::to_string(last_stamp_ns_) + " ns)");
  }
  const double step_s = SecondsBetween(last_stamp_ns_, stamp_ns);
  const double max_step_s = std::max(options_.max_stamp_step_s, 5.0 * last_step_s_);
  if (step_s <= max_step_s) {
    last_step_s_ = step_s;
    return Status::Ok();
  }
  // A real pause goes on from the refused scan, a stray stamp does not.
  const bool confirmed = refused_ns != 0 && stamp_ns > refused_ns &&
                         SecondsBetween(refused_ns, stamp_ns) <=
                             std::max(max_step_s, SecondsBetween(last_stamp_ns_, refused_ns));
  if (confirmed) {
    last_step_s_ = SecondsBetween(refused_ns, stamp_ns);
    return Status::Ok();
  }
  refused_stamp_ns_ = stamp_ns;
  return Status::InvalidArgument(Name(stamp_ns) + " is stamped " + Seconds(step_s) +
                                 " after the one before it: left out unless the next scans go on "
                                 "from there (check the lidar's clock)");
}

void LidarOdometry::StartMap(const Sweep& sweep) {
  if (last_stamp_ns_ == 0) {
    std::vector<Eigen::Vector3d> points;
    points.reserve(sweep.samples.points.size());
    for (const SweepPoint& point : sweep.samples.points) {
      points.push_back(sweep.motion.Deskew(point));
    }
    map_from_last_ = Rigid3(
        Eigen::Quaterniond::FromTwoVectors(EstimateUpFromGround(points), Eigen::Vector3d::UnitZ()),
        Eigen::Vector3d::Zero());
  }
  InsertIntoMap(sweep, map_from_last_);
}

LastSweep LidarOdometry::Last() const {
  return {map_from_last_, {velocity_in_lidar_m_s_, angular_velocity_rad_s_}, true, last_mid_ns_};
}

bool LidarOdometry::IsLost(const Placement& placement, const Sweep& sweep) const {
  // A place that merely looks alike takes half as many points as the scans before, and about as
  // large a share of those that it matches at all.
  constexpr double kMinShareOfRecent = 0.55;
  const AlignedSweep& aligned = placement.aligned;
  return aligned.num_inliers < options_.min_points / 4 ||
         aligned.num_inliers < options_.min_inlier_ratio * std::max(aligned.num_matched, 1) ||
         InlierShare(aligned, sweep.source.size()) < kMinShareOfRecent * recent_inlier_share_;
}

LidarOdometry::Placement LidarOdometry::Track(const MotionPrior& prior, Sweep* sweep) {
  const MotionExpectation expectation(Last(), sweep->samples, sweep->motion, prior);
  const Rigid3 predicted = expectation.PredictedPose();
  const double wide_kernel_m = options_.max_residual_m / 3.0;
  Placement placement;
  // Mostly the prediction is good to centimetres, and a narrow kernel needs fewer iterations.
  for (const double kernel_m : {std::min(expected_deviation_m_, wide_kernel_m), wide_kernel_m}) {
    sweep->motion.SetCorrection(expectation.PredictedCorrection());
    placement.aligned = AlignSweep(map_, sweep->source, expectation, predicted,
                                   Alignment(options_, kernel_m), &sweep->motion);
    if (!IsLost(placement, *sweep) || kernel_m == wide_kernel_m) break;
  }
  const Rigid3& pose = placement.aligned.map_from_lidar;
  placement.velocity = sweep->motion.has_duration()
                           ? sweep->motion.VelocityAtMid()
                           : VelocityBetween(map_from_last_, pose,
                                             SecondsBetween(last_mid_ns_, sweep->samples.mid_ns));
  const double deviation_m = (pose.translation - predicted.translation).norm() +
                             kLeverM * RotationAngle(predicted.rotation, pose.rotation);
  expected_deviation_m_ = std::max(deviation_m, 0.8 * expected_deviation_m_);
  return placement;
}

double LidarOdometry::OwnInlierShare(const Sweep& sweep, const MotionPrior& prior) const {
  AlignmentOptions once = Alignment(options_, 0.0);
  once.max_iterations = 1;
  once.estimate_motion = false;
  SweepMotion motion = sweep.motion;
  const MotionExpectation expectation(Last(), sweep.samples, motion, prior);
  return InlierShare(AlignSweep(map_, sweep.source, expectation, map_from_last_, once, &motion),
                     sweep.source.size());
}

LidarOdometry::Placement LidarOdometry::Bootstrap(const MotionPrior& prior, Sweep* sweep) {
  // The first scan was placed without knowing the velocity, so the map is as wrong as the second
  // scan: both are deskewed anew with the velocity found between them until it stands still.
  constexpr int kPasses = 5;
  const double seconds = SecondsBetween(last_mid_ns_, sweep->samples.mid_ns);
  Placement placement;
  Rigid3 start;
  AlignmentOptions alignment = Alignment(options_, kBootstrapKernelM);
  alignment.estimate_motion = false;
  if (!first_sweep_->motion.used_odometry()) {
    const Sweep& first = *first_sweep_;
    const StartVelocity found = SearchStartVelocity({first.samples, first.source, first.motion},
                                                    {sweep->samples, sweep->source, sweep->motion},
                                                    Last(), prior, alignment);
    placement.velocity = found.velocity;
    open_direction_in_map_ = found.open_direction_in_map;
  }
  for (int pass = 0; pass < kPasses; ++pass) {
    const MotionExpectation expectation({map_from_last_, placement.velocity, false, last_mid_ns_},
                                        sweep->samples, sweep->motion, prior);
    if (pass == 0) start = expectation.PredictedPose();
    first_sweep_->motion.SetCorrection(expectation.PredictedCorrection());
    sweep->motion.SetCorrection(expectation.PredictedCorrection());
    map_.Clear();
    InsertIntoMap(*first_sweep_, map_from_last_);
    // What the first sweep matches of itself, 0.13 with few rings and 0.5 with many: at the right
    // place the second matches four fifths of it and more.
    recent_inlier_share_ = OwnInlierShare(*first_sweep_, prior);
    placement.aligned =
        AlignSweep(map_, sweep->source, expectation, start, alignment, &sweep->motion);
    if (first_sweep_->motion.used_odometry() || IsLost(placement, *sweep)) break;
    start = placement.aligned.map_from_lidar;
    placement.velocity = VelocityBetween(map_from_last_, start, seconds);
    alignment.first_kernel_m = options_.max_residual_m / 3.0;
  }
  if (first_sweep_->motion.used_odometry()) placement.velocity = sweep->motion.VelocityAtMid();
  return placement;
}

void LidarOdometry::InsertIntoMap(const Sweep& sweep, const Rigid3& map_from_lidar) {
  std::vector<Eigen::Vector3d> points(sweep.samples.points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i] = map_from_lidar * sweep.motion.Deskew(sweep.samples.points[i]);
  }
  map_.Insert(points);
  map_.ForgetBeyond(map_from_lidar.translation, options_.max_range_m);
}

void LidarOdometry::StartAnew() {
  map_.Clear();
  ++stretch_;
  num_registered_ = num_lost_in_a_row_ = 0;
  open_direction_in_map_.reset();
  recent_inlier_share_ = 0.0;
  velocity_in_lidar_m_s_.setZero();
  angular_velocity_rad_s_.setZero();
}

LidarOdometry::Placement LidarOdometry::Place(const MotionPrior& prior, Sweep* sweep) {
  if (num_registered_ == 0) {
    StartMap(*sweep);
    Placement placement;
    placement.aligned.map_from_lidar = map_from_last_;
    return placement;
  }
  Placement placement = num_registered_ == 1 ? Bootstrap(prior, sweep) : Track(prior, sweep);
  placement.lost = IsLost(placement, *sweep);
  if (placement.lost) {
    const MotionExpectation expectation(Last(), sweep->samples, sweep->motion, prior);
    sweep->motion.SetCorrection(expectation.PredictedCorrection());
    placement.aligned.map_from_lidar = expectation.PredictedPose();
    placement.velocity = Last().velocity;
  } else {
    const double share = InlierShare(placement.aligned, sweep->source.size());
    recent_inlier_share_ =
        recent_inlier_share_ > 0.0 ? 0.8 * recent_inlier_share_ + 0.2 * share : share;
    InsertIntoMap(*sweep, placement.aligned.map_from_lidar);
  }
  return placement;
}

Result<SweepRegistration> LidarOdometry::Register(const LidarScan& scan, const MotionPrior& prior) {
  SCENECALIB_RETURN_IF_ERROR(CheckStamp(scan.stamp_ns));
  SweepSamples samples = SampleSweep(scan, Sampling(options_));
  if (samples.num_in_range < options_.min_points) {
    return Status::InvalidArgument(Name(scan.stamp_ns) + " has only " +
                                   std::to_string(samples.num_in_range) + " points within range, " +
                                   std::to_string(options_.min_points) + " are needed");
  }
  if (last_stamp_ns_ != 0 && samples.mid_ns <= last_mid_ns_) {
    return Status::InvalidArgument(Name(scan.stamp_ns) +
                                   " has points no later than those of the one before it");
  }
  if (num_registered_ > 0 && SecondsBetween(last_stamp_ns_, scan.stamp_ns) > options_.max_gap_s) {
    StartAnew();
  }
  const auto sweep = std::make_shared<Sweep>(std::move(samples), prior);
  const Placement placement = Place(prior, sweep.get());
  ForgetOpenDirection(placement);
  const SweepRegistration registration = Describe(*sweep, placement);
  first_sweep_ = num_registered_ == 0 ? sweep : placement.lost ? first_sweep_ : nullptr;
  map_from_last_ = placement.aligned.map_from_lidar;
  velocity_in_lidar_m_s_ = placement.velocity.linear_m_s;
  angular_velocity_rad_s_ = placement.velocity.angular_rad_s;
  last_stamp_ns_ = sweep->samples.stamp_ns;
  last_mid_ns_ = sweep->samples.mid_ns;
  num_registered_ += placement.lost ? 0 : 1;
  num_lost_in_a_row_ = placement.lost ? num_lost_in_a_row_ + 1 : 0;
  if (num_lost_in_a_row_ >= options_.max_lost_scans) StartAnew();
  return registration;
}

void LidarOdometry::ForgetOpenDirection(const Placement& placement) {
  // Seen from the same place again and again even a smooth tunnel seems to hold its direction (a
  // share of 0.02, from corners that few rays hit); a scene that does gives 0.1.
  constexpr double kClearlyHeld = 0.05;
  if (!open_direction_in_map_ || placement.lost || num_registered_ < 2) return;
  const Eigen::Vector3d& d = *open_direction_in_map_;
  if (d.dot(placement.aligned.translation_shares * d) > kClearlyHeld) {
    open_direction_in_map_.reset();
  }
}

SweepRegistration LidarOdometry::Describe(const Sweep& sweep, const Placement& placement) const {
  const AlignedSweep& aligned = placement.aligned;
  SweepRegistration registration;
  registration.stamp_ns = sweep.samples.stamp_ns;
  registration.first_point_ns = sweep.samples.first_ns;
  registration.last_point_ns = sweep.samples.last_ns;
  registration.map_from_lidar = aligned.map_from_lidar;
  registration.poses = sweep.motion.Poses(aligned.map_from_lidar);
  registration.converged = !placement.lost;
  registration.iterations = aligned.iterations;
  registration.num_inliers = aligned.num_inliers;
  registration.rms_m = aligned.rms_m;
  registration.stretch = stretch_;
  registration.used_gyroscope = sweep.motion.used_gyroscope();
  registration.used_odometry = sweep.motion.used_odometry();
  registration.degenerate_directions_in_map = aligned.weak_translations_in_map;
  if (open_direction_in_map_ && registration.degenerate_directions_in_map.empty()) {
    registration.degenerate_directions_in_map.push_back(*open_direction_in_map_);
  }
  registration.degenerate_axes_in_map = aligned.weak_rotations_in_map;
  return registration;
}

}  // namespace scenecalib
