#include "start_velocity.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace scenecalib {
namespace {

constexpr double kStepM = 0.8;  // between trials, per scan; within the registration's basin
constexpr double kMaxSpeed_m_s = 40.0;
constexpr double kTurnStepRad = 0.07;
constexpr double kMaxTurn_rad_s = 2.5;
// Bounds the trials of a lidar that turns slowly.
constexpr double kMaxStepM = 6.0;
constexpr double kMaxTurnRad = 0.5;
constexpr double kFirstKernelM = 0.4;
constexpr int kIterations = 8;
constexpr std::size_t kMaxSourcePoints = 1500;
constexpr std::size_t kMaxTargetPoints = 10000;
/// Another place that explains this share of what the best one does: measured 0.965 and more in
/// smooth tunnels, at most 0.91 on streets.
constexpr double kAsGood = 0.95;
constexpr double kOtherPlaceM = 0.6;

std::vector<LidarVelocity> TrialVelocities(double seconds, bool with_turns) {
  const double max_turn_rad = std::min(kMaxTurn_rad_s * seconds, kMaxTurnRad);
  const double max_step_m = std::min(kMaxSpeed_m_s * seconds, kMaxStepM);
  std::vector<LidarVelocity> trials(1);
  if (with_turns) {
    for (double turn = kTurnStepRad; turn < max_turn_rad; turn += kTurnStepRad) {
      for (const double side : {1.0, -1.0}) {
        trials.push_back({Eigen::Vector3d::Zero(), {0.0, 0.0, side * turn / seconds}});
      }
    }
  }
  for (double step = kStepM; step < max_step_m; step += kStepM) {
    const int num_directions = 4 * static_cast<int>(std::ceil(M_PI / 2.0 * step / kStepM));
    for (int i = 0; i < num_directions; ++i) {
      const double angle = 2.0 * M_PI * i / num_directions;
      trials.push_back({step / seconds * Eigen::Vector3d(std::cos(angle), std::sin(angle), 0.0),
                        Eigen::Vector3d::Zero()});
    }
  }
  return trials;
}

std::vector<SweepPoint> Thinned(const std::vector<SweepPoint>& points, std::size_t max_points) {
  const std::size_t stride = (points.size() + max_points - 1) / max_points;
  std::vector<SweepPoint> thinned;
  for (std::size_t i = 0; i < points.size(); i += stride) thinned.push_back(points[i]);
  return thinned;
}

struct Trial {
  double score = 0.0;
  Rigid3 map_from_lidar;  ///< of the second sweep
};

std::optional<Eigen::Vector3d> OpenDirection(const std::vector<Trial>& trials, const Trial& best) {
  const Trial* other = nullptr;
  for (const Trial& trial : trials) {
    const double away_m =
        (trial.map_from_lidar.translation - best.map_from_lidar.translation).norm();
    if (away_m < kOtherPlaceM || trial.score < kAsGood * best.score) continue;
    if (!other || trial.score > other->score) other = &trial;
  }
  if (!other) return std::nullopt;
  return (other->map_from_lidar.translation - best.map_from_lidar.translation).normalized();
}

}  // namespace

StartVelocity SearchStartVelocity(const StartSweep& first, const StartSweep& second,
                                  const LastSweep& last, const MotionPrior& prior,
                                  const AlignmentOptions& options) {
  const double seconds = SecondsBetween(last.mid_ns, second.samples.mid_ns);
  const auto velocities = TrialVelocities(seconds, !second.motion.used_gyroscope());
  const std::vector<SweepPoint> source = Thinned(second.source, kMaxSourcePoints);
  const std::vector<SweepPoint> target = Thinned(first.samples.points, kMaxTargetPoints);
  AlignmentOptions alignment = options;
  alignment.first_kernel_m = kFirstKernelM;
  alignment.max_iterations = kIterations;
  alignment.estimate_motion = false;
  alignment.finest_voxel_size_m = 2.0 * options.finest_voxel_size_m;
  const auto try_velocity = [&](const LidarVelocity& velocity) {
    const LastSweep start{last.map_from_lidar, velocity, false, last.mid_ns};
    SweepMotion first_motion = first.motion;
    SweepMotion second_motion = second.motion;
    const MotionExpectation expectation(start, second.samples, second_motion, prior);
    first_motion.SetCorrection(expectation.PredictedCorrection());
    second_motion.SetCorrection(expectation.PredictedCorrection());
    std::vector<Eigen::Vector3d> points;
    points.reserve(target.size());
    for (const SweepPoint& point : target) {
      points.push_back(last.map_from_lidar * first_motion.Deskew(point));
    }
    VoxelPlaneMap map(alignment.finest_voxel_size_m);
    map.Insert(points);
    const AlignedSweep aligned = AlignSweep(map, source, expectation, expectation.PredictedPose(),
                                            alignment, &second_motion);
    const double share = aligned.rms_m / kInlierResidualM;
    return Trial{aligned.num_inliers * (1.0 - share * share), aligned.map_from_lidar};
  };
  std::vector<Trial> trials(velocities.size());
  tbb::parallel_for(std::size_t{0}, trials.size(), [&](std::size_t i) {
    // A trial may end at the right place though the velocity that deskewed it is far from right:
    // once more with the velocity that leads there.
    const Trial found = try_velocity(velocities[i]);
    trials[i] = try_velocity(VelocityBetween(last.map_from_lidar, found.map_from_lidar, seconds));
  });
  const auto best =
      std::max_element(trials.begin(), trials.end(),
                       [](const Trial& a, const Trial& b) { return a.score < b.score; });
  return {VelocityBetween(last.map_from_lidar, best->map_from_lidar, seconds),
          OpenDirection(trials, *best)};
}

}  // namespace scenecalib
