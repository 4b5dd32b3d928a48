#include "scenecalib/mapping/segment_mapper.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstdint>
#include <deque>
#include <sstream>
#include <utility>

#include "buffered_scan.h"
#include "pose_table.h"
#include "scenecalib/mapping/pose_spline.h"

namespace scenecalib {
namespace {

/// After so many stamps in a row that do not increase the clock was set back (a looping replay):
/// the segment starts anew.
constexpr int kMaxReversedStamps = 10;

std::string DescribeDegenerate(const RefinementResult& refined) {
  std::ostringstream text;
  text.precision(0);
  text << "lidar: during " << std::fixed << 100.0 * refined.degenerate_share
       << " % of the drive the scene does not fix the motion along some direction (a tunnel, an "
          "open field); ";
  if (refined.odometry_scale_error) {
    text << "there it is the odometry's";
  } else {
    text << "there it is a guess: drive where there are houses, or give odometry";
  }
  return text.str();
}

std::string Percent(int part, int whole) {
  std::ostringstream text;
  text << part << " of " << whole;
  return text.str();
}

/// Empty when every scan was held in all directions.
std::string DescribeOpenDirection(const BufferedScans& scans) {
  int num_open = 0;
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  for (const auto& scan : scans) {
    const auto& open = scan->registration.degenerate_directions_in_map;
    if (open.empty()) continue;
    ++num_open;
    direction = open.front();
  }
  if (num_open == 0) return {};
  std::ostringstream text;
  text.precision(2);
  text << "lidar: in " << Percent(num_open, static_cast<int>(scans.size()))
       << " scans the scene does not fix the motion along a direction (last: " << std::fixed
       << direction.x() << ", " << direction.y() << ", " << direction.z()
       << " in the map); those were placed by odometry or constant velocity";
  return text.str();
}

std::vector<const PackedScan*> PackedScans(const BufferedScans& scans) {
  std::vector<const PackedScan*> packed;
  for (const auto& scan : scans) packed.push_back(&scan->scan);
  return packed;
}

/// The part of a trajectory between two times that it covers.
Result<Trajectory> Clipped(const Trajectory& trajectory, Timestamp start_ns, Timestamp end_ns) {
  std::vector<TimedPose> poses = {{start_ns, *trajectory.Interpolate(start_ns)}};
  for (const TimedPose& pose : trajectory.poses()) {
    if (pose.stamp_ns > start_ns && pose.stamp_ns < end_ns) poses.push_back(pose);
  }
  poses.push_back({end_ns, *trajectory.Interpolate(end_ns)});
  return Trajectory::Create(std::move(poses));
}

void Report(const LaserCorrection& lasers, MappingReport* report) {
  report->laser_range_m = lasers.RootMeanSquare()[0];
  report->laser_elevation_rad = lasers.RootMeanSquare()[1];
}

}  // namespace

struct SegmentMapper::Impl {
  Impl(Rig rig_in, const MappingOptions& options_in)
      : rig(std::move(rig_in)), options(options_in), prior(rig), odometry(options_in.odometry) {}

  Result<RefinementResult> Refine(const BufferedScans& used, const PoseSpline& initial,
                                  const ProgressCallback& progress) const {
    RefinementOptions refinement = options.refinement;
    refinement.estimate_lasers = EstimatesLasers();
    return RefineTrajectory(initial, PackedScans(used), prior, refinement, progress);
  }
  /// Where points are moved to one time their elevations are no laser's.
  bool EstimatesLasers() const {
    return options.refinement.estimate_lasers && !rig.lidar.motion_compensated;
  }
  void ForgetOldest();
  void AddWarnings(const BufferedScans& used, MappingReport* report) const;
  Result<MappingResult> Build(const BufferedScans& used, Trajectory trajectory,
                              const LaserCorrection& lasers, MappingReport report,
                              const ProgressCallback& progress) const;

  Rig rig;
  MappingOptions options;
  MotionPrior prior;
  LidarOdometry odometry;
  std::deque<std::shared_ptr<const BufferedScan>> scans;
  int num_scans_in = 0;
  int num_scans_skipped = 0;
  int num_scans_dropped = 0;
  std::int64_t num_points = 0;  ///< of all scans
  int num_reversed_in_a_row = 0;
  int num_clock_resets = 0;
};

SegmentMapper::SegmentMapper(const Rig& rig, const MappingOptions& options)
    : impl_(std::make_unique<Impl>(rig, options)) {}
SegmentMapper::~SegmentMapper() = default;
SegmentMapper::SegmentMapper(SegmentMapper&&) noexcept = default;
SegmentMapper& SegmentMapper::operator=(SegmentMapper&&) noexcept = default;

void SegmentMapper::AddImu(const ImuSample& sample) { impl_->prior.AddImu(sample); }
void SegmentMapper::AddOdometry(const OdometrySample& sample) { impl_->prior.AddOdometry(sample); }
int SegmentMapper::num_scans() const { return static_cast<int>(impl_->scans.size()); }
void SegmentMapper::Reset() { impl_ = std::make_unique<Impl>(impl_->rig, impl_->options); }

SegmentMapper SegmentMapper::Clone() const {
  SegmentMapper clone(impl_->rig, impl_->options);
  *clone.impl_ = *impl_;
  return clone;
}

Result<ScanRegistration> SegmentMapper::AddScan(const LidarScan& scan) {
  Impl& impl = *impl_;
  ++impl.num_scans_in;
  const bool reversed = !impl.scans.empty() && scan.stamp_ns <= impl.scans.back()->scan.stamp_ns();
  impl.num_reversed_in_a_row = reversed ? impl.num_reversed_in_a_row + 1 : 0;
  if (impl.num_reversed_in_a_row >= kMaxReversedStamps) {
    const int num_clock_resets = impl.num_clock_resets + 1;
    Reset();
    impl_->num_clock_resets = num_clock_resets;
    return AddScan(scan);
  }
  auto registration = impl.odometry.Register(scan, impl.prior);
  if (!registration.ok()) {
    ++impl.num_scans_skipped;
    return registration.status();
  }
  impl.scans.push_back(std::make_shared<const BufferedScan>(BufferedScan{
      PackedScan(scan, impl.options.odometry.min_range_m, impl.options.odometry.max_range_m),
      *registration}));
  impl.num_points += static_cast<std::int64_t>(impl.scans.back()->scan.size());
  impl.ForgetOldest();
  impl.prior.ForgetBefore(AddSeconds(scan.stamp_ns, -impl.options.buffer.max_imu_age_s));
  ScanRegistration result;
  result.stamp_ns = scan.stamp_ns;
  const auto sweep = Trajectory::Create(registration->poses);
  if (!sweep.ok()) return sweep.status();
  result.map_from_lidar =
      *sweep->Interpolate(std::clamp(scan.stamp_ns, sweep->start_ns(), sweep->end_ns()));
  result.converged = registration->converged;
  result.iterations = registration->iterations;
  result.num_inliers = registration->num_inliers;
  result.rms_m = registration->rms_m;
  result.degenerate_directions_in_map = registration->degenerate_directions_in_map;
  return result;
}

void SegmentMapper::Impl::ForgetOldest() {
  const ScanBufferOptions& bound = options.buffer;
  while (scans.size() > 1 &&
         (static_cast<int>(scans.size()) > bound.max_scans || num_points > bound.max_points)) {
    num_points -= static_cast<std::int64_t>(scans.front()->scan.size());
    scans.pop_front();
    ++num_scans_dropped;
  }
}

void SegmentMapper::Impl::AddWarnings(const BufferedScans& used, MappingReport* report) const {
  auto warn = [report](const std::string& text) { report->warnings.push_back(text); };
  const int num_used = static_cast<int>(used.size());
  const auto count = [&used](bool SweepRegistration::*flag) {
    return static_cast<int>(std::count_if(used.begin(), used.end(),
                                          [flag](const auto& s) { return s->registration.*flag; }));
  };
  if (num_scans_skipped > 0) {
    warn("lidar: " + Percent(num_scans_skipped, num_scans_in) +
         " scans skipped (stamp not increasing or far ahead of the others, or too few points)");
  }
  if (num_scans_dropped > 0) {
    warn("lidar: the buffer was full (buffer.max_scans " +
         std::to_string(options.buffer.max_scans) + ", buffer.max_points " +
         std::to_string(options.buffer.max_points) + "); the oldest " +
         Percent(num_scans_dropped, num_scans_in) + " scans were forgotten");
  }
  if (num_clock_resets > 0) warn("lidar: stamps ran backwards; what came before was dropped");
  const int num_unused = static_cast<int>(scans.size()) - num_used;
  if (num_unused > 0) {
    warn("lidar: tracking was lost; " + Percent(num_unused, static_cast<int>(scans.size())) +
         " scans lie outside the longest tracked stretch and are not used");
  }
  const std::string open = DescribeOpenDirection(used);
  if (!open.empty()) warn(open);
  if (rig.imu && count(&SweepRegistration::used_gyroscope) < num_used) {
    warn("imu: no gapless samples for " +
         Percent(num_used - count(&SweepRegistration::used_gyroscope), num_used) +
         " scans (topic " + rig.imu->topic + "); their rotation comes from the lidar alone");
  }
  if (rig.odometry && count(&SweepRegistration::used_odometry) < num_used) {
    warn("odometry: no gapless samples for " +
         Percent(num_used - count(&SweepRegistration::used_odometry), num_used) + " scans (topic " +
         rig.odometry->topic + "); constant velocity is assumed there");
  }
  report->used_imu = count(&SweepRegistration::used_gyroscope) > 0;
  report->used_odometry = count(&SweepRegistration::used_odometry) > 0;
}

Result<MappingResult> SegmentMapper::Impl::Build(const BufferedScans& used, Trajectory trajectory,
                                                 const LaserCorrection& lasers,
                                                 MappingReport report,
                                                 const ProgressCallback& progress) const {
  const PoseTable table(trajectory);
  const BufferedScans spread = SpreadForSurfaces(used, table, options.buffer.max_surface_points);
  if (spread.size() < used.size()) {
    report.warnings.push_back(
        "lidar: the surfaces are built from " +
        Percent(static_cast<int>(spread.size()), static_cast<int>(used.size())) +
        " scans (buffer.max_surface_points " + std::to_string(options.buffer.max_surface_points) +
        "); the trajectory from all");
  }
  std::vector<RegisteredScan> registered(spread.size());
  tbb::parallel_for(std::size_t{0}, spread.size(),
                    [&](std::size_t i) { registered[i] = PlaceInMap(*spread[i], lasers, table); });
  auto surfaces = BuildSurfaces(registered, options.surfaces, progress);
  if (!surfaces.ok()) return surfaces.status();
  report.num_scans_used = static_cast<int>(used.size());
  report.airborne_share = AirborneShare(used);
  report.path_length_m = PathLength(trajectory.poses());
  report.num_points_moving = surfaces->num_points_moving;
  MappingResult result;
  result.map.map_from_lidar = std::move(trajectory);
  result.map.ground = std::move(surfaces->ground);
  result.map.surfels = std::move(surfaces->surfels);
  result.map.points = std::move(surfaces->points);
  const LaserCorrection::Errors sigma = lasers.MeanSigma();
  result.map.lidar_frame = {sigma[0], sigma[1]};
  result.report = std::move(report);
  return result;
}

Result<MappingResult> SegmentMapper::BuildMap(const ProgressCallback& progress) const {
  const Impl& impl = *impl_;
  const BufferedScans used = LongestStretch(impl.scans);
  if (static_cast<int>(used.size()) < impl.options.segment.min_scans) {
    return Status::InsufficientData("lidar: " + std::to_string(used.size()) + " usable scans (of " +
                                    std::to_string(impl.num_scans_in) + " received), at least " +
                                    std::to_string(impl.options.segment.min_scans) + " are needed");
  }
  const auto odometry = Trajectory::Create(OdometryPoses(used));
  if (!odometry.ok()) return odometry.status();
  const double path_length_m = PathLength(odometry->poses());
  if (path_length_m < impl.options.segment.min_path_length_m) {
    std::ostringstream text;
    text.precision(2);
    text << "lidar: the vehicle did not move (" << std::fixed << path_length_m
         << " m travelled, at least " << impl.options.segment.min_path_length_m
         << " m are needed): record while driving";
    return Status::InsufficientData(text.str());
  }
  MappingReport report;
  report.num_scans_in = impl.num_scans_in;
  report.num_scans_dropped_at_bound = impl.num_scans_dropped;
  impl.AddWarnings(used, &report);
  PoseSpline spline(*odometry, impl.options.refinement.knot_interval_s);
  std::vector<RelativeMotionSigma> relative_motion;
  LaserCorrection lasers;
  std::optional<Eigen::Vector3d> gravity;
  if (impl.options.refinement.enabled) {
    const auto refined = impl.Refine(used, spline, progress);
    if (!refined.ok()) return refined.status();
    spline = refined->map_from_lidar;
    relative_motion = refined->relative_motion;
    lasers = refined->lasers;
    Report(lasers, &report);
    if (refined->degenerate_share > 0.0) {
      report.warnings.push_back(DescribeDegenerate(*refined));
    }
    gravity = refined->gravity_in_map_m_s2;
    report.thickness_before_m = refined->thickness_before_m;
    report.thickness_after_m = refined->thickness_after_m;
  }
  auto trajectory = Trajectory::Create(LeveledPoses(spline, gravity));
  if (!trajectory.ok()) return trajectory.status();
  auto result = impl.Build(used, std::move(*trajectory), lasers, std::move(report), progress);
  if (result.ok()) result->map.relative_motion = std::move(relative_motion);
  return result;
}

Result<MappingResult> SegmentMapper::BuildMapWithTrajectory(
    const Trajectory& map_from_lidar, const ProgressCallback& progress) const {
  const Impl& impl = *impl_;
  BufferedScans used;
  for (const auto& scan : impl.scans) {
    if (map_from_lidar.Covers(scan->registration.first_point_ns) &&
        map_from_lidar.Covers(scan->registration.last_point_ns)) {
      used.push_back(scan);
    }
  }
  if (used.empty()) {
    return Status::InsufficientData("the given trajectory covers none of the " +
                                    std::to_string(impl.scans.size()) + " lidar scans");
  }
  MappingReport report;
  report.num_scans_in = impl.num_scans_in;
  report.num_scans_dropped_at_bound = impl.num_scans_dropped;
  LaserCorrection lasers;
  std::vector<RelativeMotionSigma> relative_motion;
  if (impl.options.refinement.enabled) {
    // How far the lidar would move it is what it is off by, and what the lidar itself is.
    const auto during_scans = Clipped(map_from_lidar, used.front()->registration.first_point_ns,
                                      used.back()->registration.last_point_ns);
    if (!during_scans.ok()) return during_scans.status();
    const auto refined = impl.Refine(
        used, PoseSpline(*during_scans, impl.options.refinement.knot_interval_s), progress);
    if (refined.status().code() == Status::Code::kCancelled) return refined.status();
    if (refined.ok()) {
      relative_motion = RelativeMotionDifference(map_from_lidar, refined->map_from_lidar);
    }
    if (impl.EstimatesLasers()) {
      auto estimated = EstimateLasers(map_from_lidar, PackedScans(used), impl.options.refinement);
      if (estimated.ok()) {
        lasers = std::move(*estimated);
        Report(lasers, &report);
      } else {
        report.warnings.push_back("lidar: lasers are not corrected; " +
                                  estimated.status().message());
      }
    }
  }
  auto result = impl.Build(used, map_from_lidar, lasers, std::move(report), progress);
  if (result.ok()) result->map.relative_motion = std::move(relative_motion);
  return result;
}

}  // namespace scenecalib
