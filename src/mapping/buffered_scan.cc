#include "buffered_scan.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstdint>

#include "airborne_returns.h"

namespace scenecalib {
namespace {

constexpr double kTrajectoryStepS = 0.005;

/// The poses of one sweep. The first sweep was registered before any motion was known: it borrows
/// the second one's, which is constant velocity.
std::vector<TimedPose> SweepPoses(const BufferedScans& scans, std::size_t index) {
  const SweepRegistration& own = scans[index]->registration;
  if (index > 0 || own.used_odometry || scans.size() < 2) return own.poses;
  const SweepRegistration& next = scans[1]->registration;
  const Timestamp shift_ns = own.mid_ns() - next.mid_ns();
  const Rigid3 move = own.map_from_lidar * next.map_from_lidar.Inverse();
  std::vector<TimedPose> poses;
  for (const TimedPose& pose : next.poses) {
    poses.push_back({pose.stamp_ns + shift_ns, move * pose.map_from_lidar});
  }
  poses.front().stamp_ns = std::min(poses.front().stamp_ns, own.first_point_ns);
  return poses;
}

}  // namespace

double PathLength(const std::vector<TimedPose>& poses) {
  constexpr double kMinStepM = 0.1;
  double length_m = 0.0;
  Eigen::Vector3d last = poses.front().map_from_lidar.translation;
  for (const TimedPose& pose : poses) {
    const double step_m = (pose.map_from_lidar.translation - last).norm();
    if (step_m < kMinStepM) continue;
    length_m += step_m;
    last = pose.map_from_lidar.translation;
  }
  return length_m;
}

double AirborneShare(const BufferedScans& scans) {
  constexpr std::size_t kMaxScans = 15;
  if (scans.empty()) return 0.0;
  std::vector<double> shares(std::min(kMaxScans, scans.size()));
  tbb::parallel_for(std::size_t{0}, shares.size(), [&](std::size_t i) {
    shares[i] = AirborneShare(scans[i * scans.size() / shares.size()]->scan);
  });
  const auto middle = shares.begin() + static_cast<std::ptrdiff_t>(shares.size() / 2);
  std::nth_element(shares.begin(), middle, shares.end());
  return *middle;
}

BufferedScans LongestStretch(const std::deque<std::shared_ptr<const BufferedScan>>& scans) {
  std::vector<BufferedScans> stretches;
  for (const auto& scan : scans) {
    if (!scan->registration.converged) continue;
    if (stretches.empty() ||
        stretches.back().back()->registration.stretch != scan->registration.stretch) {
      stretches.emplace_back();
    }
    stretches.back().push_back(scan);
  }
  if (stretches.empty()) return {};
  return *std::max_element(
      stretches.begin(), stretches.end(),
      [](const BufferedScans& a, const BufferedScans& b) { return a.size() < b.size(); });
}

std::vector<TimedPose> OdometryPoses(const BufferedScans& scans) {
  std::vector<TimedPose> poses;
  for (std::size_t i = 0; i < scans.size(); ++i) {
    const bool last = i + 1 == scans.size();
    const Timestamp end_ns =
        last ? scans[i]->registration.last_point_ns : scans[i + 1]->registration.first_point_ns - 1;
    for (const TimedPose& pose : SweepPoses(scans, i)) {
      if (pose.stamp_ns > end_ns) break;
      if (poses.empty() || pose.stamp_ns > poses.back().stamp_ns) poses.push_back(pose);
    }
  }
  return poses;
}

BufferedScans SpreadForSurfaces(const BufferedScans& scans, const PoseTable& table,
                                int max_points) {
  std::int64_t num_points = 0;
  for (const auto& scan : scans) num_points += static_cast<std::int64_t>(scan->scan.size());
  if (num_points <= max_points) return scans;
  constexpr double kWorthOfASecondM = 0.5;
  std::vector<double> worth_m;  // up to each scan
  Eigen::Vector3d last_m = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < scans.size(); ++i) {
    const Timestamp mid_ns = scans[i]->registration.mid_ns();
    const Eigen::Vector3d place_m =
        table.Place(Eigen::Vector3d::Zero(), SecondsBetween(table.start_ns(), mid_ns));
    if (i == 0) {
      worth_m.push_back(0.0);
    } else {
      worth_m.push_back(worth_m.back() + (place_m - last_m).norm() +
                        kWorthOfASecondM *
                            SecondsBetween(scans[i - 1]->registration.mid_ns(), mid_ns));
    }
    last_m = place_m;
  }
  const auto num_kept = static_cast<std::int64_t>(static_cast<double>(scans.size()) * max_points /
                                                  static_cast<double>(num_points));
  BufferedScans kept;
  std::int64_t num_kept_points = 0;
  for (std::size_t i = 0; i < scans.size(); ++i) {
    const double due_m = worth_m.back() * static_cast<double>(kept.size()) /
                         static_cast<double>(std::max<std::int64_t>(num_kept, 1));
    const auto size = static_cast<std::int64_t>(scans[i]->scan.size());
    if (worth_m[i] < due_m || num_kept_points + size > max_points) continue;
    kept.push_back(scans[i]);
    num_kept_points += size;
  }
  return kept;
}

RegisteredScan PlaceInMap(const BufferedScan& buffered, const LaserCorrection& lasers,
                          const PoseTable& table) {
  const PackedScan& scan = buffered.scan;
  RegisteredScan registered;
  registered.stamp_ns = scan.stamp_ns();
  const double stamp_s = SecondsBetween(table.start_ns(), scan.stamp_ns());
  registered.lidar_in_map_m = table.Place(
      Eigen::Vector3d::Zero(), SecondsBetween(table.start_ns(), buffered.registration.mid_ns()));
  registered.points.reserve(scan.size());
  for (std::size_t i = 0; i < scan.size(); ++i) {
    RegisteredPoint placed;
    placed.time_offset_s = scan.time_offset_s(i);
    placed.position_in_map_m = table
                                   .Place(lasers.Apply(scan.position_in_lidar_m(i).cast<double>()),
                                          stamp_s + placed.time_offset_s)
                                   .cast<float>();
    placed.intensity = scan.intensity(i);
    registered.points.push_back(placed);
  }
  return registered;
}

std::vector<TimedPose> LeveledPoses(const PoseSpline& spline,
                                    const std::optional<Eigen::Vector3d>& gravity) {
  const Eigen::Quaterniond level =
      gravity ? Eigen::Quaterniond::FromTwoVectors(-*gravity, Eigen::Vector3d::UnitZ())
              : Eigen::Quaterniond::Identity();
  const Rigid3 map_from_spline(level, -(level * spline.PoseAt(0.0).translation));
  std::vector<TimedPose> poses = spline.Sample(kTrajectoryStepS);
  for (TimedPose& pose : poses) pose.map_from_lidar = map_from_spline * pose.map_from_lidar;
  return poses;
}

}  // namespace scenecalib
