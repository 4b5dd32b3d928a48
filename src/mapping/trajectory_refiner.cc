#include "scenecalib/mapping/trajectory_refiner.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <sstream>
#include <string>
#include <utility>

#include "inertial_terms.h"
#include "odometry_terms.h"
#include "plane_patches.h"
#include "refinement_system.h"
#include "scenecalib/base/log.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/mapping/voxel_plane_map.h"

namespace scenecalib {
namespace {

using ControlJacobians = std::array<Eigen::Matrix<double, 3, RefinementSystem::kPose>, 4>;

/// What is found of lasers that are right, m and rad: bumps and curved surfaces pass for it. By
/// elevation it is smooth, so that it moves everything that cameras see near the vehicle alike.
const LaserCorrection::Errors kUnrealLaserErrors(1e-3, 3.5e-5, 3.5e-5);

void TakeStep(const Eigen::VectorXd& step, LaserCorrection* lasers) {
  lasers->Add(step.tail(3 * static_cast<Eigen::Index>(lasers->num_nodes())));
  lasers->Shrink(kUnrealLaserErrors);
}

/// Keeps the jerk of each knot interval within its sigma: decides only where lidar and IMU are
/// silent.
void AddSmoothness(const PoseSpline& spline, const RefinementOptions& options,
                   RefinementSystem* system) {
  const double cube = std::pow(spline.knot_interval_s(), 3);
  const Eigen::Vector3d translation_weight =
      Eigen::Vector3d::Constant(std::pow(options.max_jerk_m_s3 * cube, -2));
  const Eigen::Vector3d rotation_weight =
      Eigen::Vector3d::Constant(std::pow(options.max_angular_jerk_rad_s3 * cube, -2));
  const std::array<double, 4> difference = {-1.0, 3.0, -3.0, 1.0};
  const auto& controls = spline.controls();
  for (int k = 0; k + 3 < static_cast<int>(controls.size()); ++k) {
    ControlJacobians translation;
    ControlJacobians rotation;
    Eigen::Vector3d translation_residual = Eigen::Vector3d::Zero();
    for (int j = 0; j < 4; ++j) {
      translation[j].setZero();
      rotation[j].setZero();
      translation[j].leftCols<3>() = difference[j] * Eigen::Matrix3d::Identity();
      rotation[j].rightCols<3>() = difference[j] * Eigen::Matrix3d::Identity();
      translation_residual += difference[j] * controls[k + j].translation;
    }
    const auto turn = [&](int j) {  // from control k + j to the next, in the map frame
      return LogSo3(controls[k + j + 1].rotation * controls[k + j].rotation.conjugate());
    };
    const Eigen::Vector3d rotation_residual = turn(2) - 2.0 * turn(1) + turn(0);
    const auto none = RefinementSystem::GlobalJacobian::Zero();
    system->AddResidual(k, translation, none, translation_residual, translation_weight);
    system->AddResidual(k, rotation, none, rotation_residual, rotation_weight);
  }
}

/// Holds the trajectory's first pose: the data only speak of relative motion.
void AddGauge(RefinementSystem* system) {
  constexpr double kSigma = 1e-3;  // m or rad
  for (int i = 0; i < RefinementSystem::kPose; ++i) {
    system->AddPrior(i, 0.0, 1.0 / (kSigma * kSigma));
  }
}

/// Moves the control poses; returns the RMS change of the motion from a control to the next, in
/// metres and radians.
Eigen::Vector2d ApplyStep(const Eigen::VectorXd& step, PoseSpline* spline) {
  Eigen::Vector2d squares = Eigen::Vector2d::Zero();
  auto& controls = spline->controls();
  for (std::size_t k = 0; k < controls.size(); ++k) {
    const auto offset = static_cast<Eigen::Index>(RefinementSystem::kPose * k);
    const Eigen::Vector3d tau = step.segment<3>(offset);
    const Eigen::Vector3d phi = step.segment<3>(offset + 3);
    if (k > 0) {
      squares[0] += (tau - step.segment<3>(offset - RefinementSystem::kPose)).squaredNorm();
      squares[1] += (phi - step.segment<3>(offset - RefinementSystem::kPose + 3)).squaredNorm();
    }
    controls[k] = Rigid3(ExpSo3(phi) * controls[k].rotation, controls[k].translation + tau);
  }
  return (squares / static_cast<double>(controls.size() - 1)).cwiseSqrt();
}

/// What is measured besides the lidar's points.
struct MotionTerms {
  InertialTerms inertial;
  OdometryTerms odometry;
};

DegenerateDirections FindDegenerate(const PoseSpline& spline,
                                    const std::vector<PlanePatch>& patches) {
  return {patches, SecondsBetween(spline.start_ns(), spline.end_ns())};
}

/// With `lasers` their errors are unknowns too.
RefinementSystem Linearise(const PoseSpline& spline, const std::vector<PlanePatch>& patches,
                           const std::vector<bool>& use, const MotionTerms& motion,
                           DataSubset subset, const RefinementOptions& options,
                           const LaserCorrection* lasers = nullptr) {
  RefinementSystem system(static_cast<int>(spline.controls().size()),
                          lasers != nullptr ? 3 * static_cast<int>(lasers->num_nodes()) : 0);
  // Without odometry the trajectory as it came is the best guess along a degenerate direction.
  const DegenerateDirections degenerate =
      motion.odometry.empty() ? DegenerateDirections() : FindDegenerate(spline, patches);
  system.AddPatches(spline, patches, use, degenerate);
  // What the data tell clearly comes out in two rounds, while bumps of the ground, which every scan
  // sees alike, would pass for lasers' errors that bend the drive (docs/math.md).
  constexpr double kHeldBack = 0.5;
  if (lasers != nullptr) system.AddLaserPriors(*lasers, kHeldBack);
  motion.inertial.AddTo(spline, subset, &system);
  motion.odometry.AddTo(spline, subset, &system);
  AddSmoothness(spline, options, &system);
  AddGauge(&system);
  return system;
}

using PoseAtTime = std::function<Rigid3(double seconds)>;

/// RMS over a duration of the difference between two trajectories' motions within windows of some
/// lengths.
std::vector<RelativeMotionSigma> RelativeMotionDifference(const PoseAtTime& a, const PoseAtTime& b,
                                                          double duration_s) {
  std::vector<RelativeMotionSigma> differences;
  constexpr double kStepS = 0.02;
  for (const double window_s : {0.1, 0.5, 1.0, 4.0}) {
    double translation = 0.0;
    double rotation = 0.0;
    int count = 0;
    for (double t = 0.0; t + window_s <= duration_s; t += kStepS, ++count) {
      const Rigid3 motion_a = a(t).Inverse() * a(t + window_s);
      const Rigid3 motion_b = b(t).Inverse() * b(t + window_s);
      translation += (motion_a.Inverse() * motion_b).translation.squaredNorm();
      const double angle = RotationAngle(motion_a.rotation, motion_b.rotation);
      rotation += angle * angle;
    }
    if (count == 0) break;
    differences.push_back({window_s, std::sqrt(translation / count), std::sqrt(rotation / count)});
  }
  return differences;
}

PoseAtTime PosesOf(const PoseSpline& spline) {
  return [&spline](double seconds) { return spline.PoseAt(seconds); };
}

/// RMS relative-motion error from the difference of two trajectories, each from half of the data:
/// the mean of the two, which is about the full solution, is off by half their difference. What
/// both halves have in common (the sensor's own bias, shared weights) does not show. With these
/// factors what is stated is 1.0 to 1.8 times the true error in three simulated worlds, with and
/// without IMU.
std::vector<RelativeMotionSigma> HalfDifference(const PoseSpline& a, const PoseSpline& b) {
  constexpr double kTranslationFactor = 2.0;
  constexpr double kRotationFactor = 1.4;
  std::vector<RelativeMotionSigma> sigmas =
      RelativeMotionDifference(PosesOf(a), PosesOf(b), SecondsBetween(a.start_ns(), a.end_ns()));
  for (RelativeMotionSigma& sigma : sigmas) {
    sigma.translation_m *= 0.5 * kTranslationFactor;
    sigma.rotation_rad *= 0.5 * kRotationFactor;
  }
  return sigmas;
}

/// Splits the patches into two halves by blocks of space, so that a bent facade or a wrong
/// association of several neighbouring patches falls into one half.
std::vector<bool> InHalf(const std::vector<PlanePatch>& patches, bool first) {
  constexpr double kBlockM = 4.0;
  std::vector<bool> use(patches.size());
  for (std::size_t i = 0; i < patches.size(); ++i) {
    std::uint64_t hash = VoxelKey::Of(patches[i].center_m, kBlockM) * 0x9e3779b97f4a7c15ULL;
    hash ^= hash >> 31;
    hash *= 0xbf58476d1ce4e5b9ULL;
    use[i] = ((hash >> 40) & 1U) == (first ? 1U : 0U);
  }
  return use;
}

/// What all rounds share.
struct Problem {
  const std::vector<const PackedScan*>& scans;
  const RefinementOptions& options;
};

/// Planar patches as the trajectory places the points. The first rounds only have to come close:
/// there a share of the points is enough.
Result<std::vector<PlanePatch>> Associate(const Problem& problem, const PoseTable& map_from_lidar,
                                          const LaserCorrection& lasers, bool by_laser,
                                          bool all_points) {
  constexpr int kMinPatches = 50;
  constexpr int kShare = 4;
  RefinementOptions options = problem.options;
  if (!all_points) options.max_points = options.max_points / kShare;
  auto patches = FindPlanePatches(problem.scans, lasers, by_laser, map_from_lidar, options);
  if (patches.size() < kMinPatches) {
    return Status::InsufficientData("lidar: only " + std::to_string(patches.size()) +
                                    " planar patches in the scene, at least " +
                                    std::to_string(kMinPatches) + " are needed");
  }
  return patches;
}

Result<std::vector<PlanePatch>> Associate(const Problem& problem, const PoseSpline& spline,
                                          const LaserCorrection& lasers, bool by_laser,
                                          bool all_points) {
  constexpr double kPlacementStepS = 0.005;
  const auto trajectory = Trajectory::Create(spline.Sample(kPlacementStepS));
  if (!trajectory.ok()) return trajectory.status();
  return Associate(problem, PoseTable(*trajectory), lasers, by_laser, all_points);
}

/// Median thickness at the finest scale only: how far coarse patches are split depends on the
/// trajectory, which would make two trajectories' thicknesses incomparable. A share of the points
/// tells it.
double MeasureThickness(const Problem& problem, const PoseSpline& spline,
                        const LaserCorrection& lasers) {
  RefinementOptions options = problem.options;
  options.num_patch_scales = 1;
  const Problem finest{problem.scans, options};
  const auto patches = Associate(finest, spline, lasers, false, false);
  return patches.ok() ? MedianThickness(*patches) : 0.0;
}

/// Where a step only has to come close (the first rounds, and the halves, whose difference is a
/// measure of noise), solving it further than the next association would move it again is lost.
double CloseTolerance(const RefinementOptions& options) {
  constexpr double kClose = 0.01;
  return std::max(kClose, options.solver_tolerance);
}

/// What both halves of the data do not see: along a degenerate direction the odometry's scale is
/// the error, and it is the same for both. Without odometry the way is what the registration of one
/// scan after the other made of it: in tunnels off by 0.9 to 1.9 %, where both halves agree to much
/// less.
void AddUnseenError(const PoseSpline& spline, const DegenerateDirections& degenerate,
                    const OdometryTerms& odometry, std::vector<RelativeMotionSigma>* sigmas) {
  constexpr double kGuessedShare = 0.03;
  if (degenerate.share() == 0.0) return;
  const double share_sigma =
      odometry.empty() ? kGuessedShare : odometry.ScaleSigma(spline, degenerate);
  const double duration_s = SecondsBetween(spline.start_ns(), spline.end_ns());
  constexpr double kStepS = 0.1;
  for (RelativeMotionSigma& sigma : *sigmas) {
    double squares = 0.0;
    int count = 0;
    for (double t = 0.0; t + sigma.window_s <= duration_s; t += kStepS, ++count) {
      const Eigen::Vector3d way =
          spline.PoseAt(t + sigma.window_s).translation - spline.PoseAt(t).translation;
      const Eigen::Vector3d unseen = way - degenerate.Projection(t + 0.5 * sigma.window_s) * way;
      squares += share_sigma * share_sigma * unseen.squaredNorm();
    }
    sigma.translation_m = std::hypot(sigma.translation_m, std::sqrt(squares / count));
  }
}

std::vector<RelativeMotionSigma> EstimateRelativeMotion(const PoseSpline& spline,
                                                        const std::vector<PlanePatch>& patches,
                                                        const MotionTerms& motion,
                                                        const RefinementOptions& options) {
  std::array<PoseSpline, 2> halves = {spline, spline};
  for (const bool first : {true, false}) {
    const auto solution = Linearise(spline, patches, InHalf(patches, first), motion,
                                    first ? DataSubset::kEven : DataSubset::kOdd, options)
                              .Solve(options.max_solver_iterations, CloseTolerance(options));
    if (!solution.ok) return {};
    ApplyStep(solution.step, &halves[first ? 0 : 1]);
  }
  return HalfDifference(halves[0], halves[1]);
}

/// A step, RMS from a knot to the next, that no longer matters: a tenth of a millimetre, or half of
/// what the data leave undecided over a tenth of a second. Every association shifts the trajectory
/// by a share of the latter, for ever.
bool IsStill(const Eigen::Vector2d& change, const std::vector<RelativeMotionSigma>& sigmas) {
  constexpr double kStillM = 1e-4;
  constexpr double kStillRad = 1.5e-5;
  constexpr double kShareOfNoise = 0.5;
  const RelativeMotionSigma shortest = sigmas.empty() ? RelativeMotionSigma() : sigmas.front();
  return change[0] < std::max(kStillM, kShareOfNoise * shortest.translation_m) &&
         change[1] < std::max(kStillRad, kShareOfNoise * shortest.rotation_rad);
}

std::string DescribeRound(int round, const std::vector<PlanePatch>& patches,
                          const Eigen::Vector2d& change, int iterations) {
  std::ostringstream text;
  text << "trajectory refinement, round " << round << ": " << patches.size()
       << " patches, thickness " << 1e3 * MedianThickness(patches) << " mm, RMS step "
       << 1e3 * change[0] << " mm " << 1e3 * change[1] << " mrad, " << iterations
       << " solver iterations";
  return text.str();
}

}  // namespace

Result<RefinementResult> RefineTrajectory(const PoseSpline& initial,
                                          const std::vector<const PackedScan*>& scans,
                                          const MotionPrior& prior,
                                          const RefinementOptions& options,
                                          const ProgressCallback& progress) {
  // RMS steps, from a knot to the next, that call for all points.
  constexpr double kCloseM = 1e-3;
  constexpr double kCloseRad = 2e-4;
  const Problem problem{scans, options};
  RefinementResult result;
  result.map_from_lidar = initial;
  PoseSpline& spline = result.map_from_lidar;
  MotionTerms motion{InertialTerms(prior, spline, options.use_accelerometer),
                     OdometryTerms(prior, spline, options.use_odometry)};
  LaserCorrection& lasers = result.lasers;
  if (options.estimate_lasers) lasers = LaserCorrection(scans);
  Result<std::vector<PlanePatch>> patches =
      Associate(problem, spline, lasers, !lasers.empty(), false);
  if (!patches.ok()) return patches.status();
  result.thickness_before_m = MeasureThickness(problem, spline, lasers);
  bool is_close = false;
  while (result.num_rounds < options.max_rounds && !result.converged) {
    if (!ReportProgress(progress, "mapping: refinement",
                        static_cast<double>(result.num_rounds) / options.max_rounds)) {
      return Status::Cancelled("mapping was cancelled");
    }
    const bool all_points = is_close || 2 * (result.num_rounds + 1) > options.max_rounds;
    // A share of the points tells the lasers' errors too.
    const bool by_laser = !lasers.empty() && !all_points;
    if (result.num_rounds > 0 || all_points) {
      patches = Associate(problem, spline, lasers, by_laser, all_points);
    }
    if (!patches.ok()) return patches.status();
    motion.inertial.UpdateSigmas(spline);
    motion.odometry.UpdateSigma(spline);
    const auto solution =
        Linearise(spline, *patches, std::vector<bool>(patches->size(), true), motion,
                  DataSubset::kAll, options, by_laser ? &lasers : nullptr)
            .Solve(options.max_solver_iterations,
                   all_points ? options.solver_tolerance : CloseTolerance(options));
    if (!solution.ok) return Status::NumericalFailure("the trajectory's normal equations failed");
    const Eigen::Vector2d change = ApplyStep(solution.step, &spline);
    const auto num_poses =
        static_cast<Eigen::Index>(RefinementSystem::kPose * spline.controls().size());
    const RefinementSystem::Globals globals =
        solution.step.segment<RefinementSystem::kNumGlobals>(num_poses);
    if (by_laser) TakeStep(solution.step, &lasers);
    motion.inertial.Update(globals);
    motion.odometry.Update(globals);
    ++result.num_rounds;
    Log(LogSeverity::kDebug,
        DescribeRound(result.num_rounds, *patches, change, solution.iterations));
    if (all_points && result.relative_motion.empty()) {
      // Once is enough: in a difference of two halves what remains to be moved cancels.
      result.relative_motion = EstimateRelativeMotion(spline, *patches, motion, options);
    }
    is_close = all_points || (change[0] < kCloseM && change[1] < kCloseRad);
    result.converged = all_points && IsStill(change, result.relative_motion);
  }
  const DegenerateDirections degenerate = FindDegenerate(spline, *patches);
  AddUnseenError(spline, degenerate, motion.odometry, &result.relative_motion);
  result.degenerate_share = degenerate.share();
  result.num_patches = static_cast<int>(patches->size());
  for (const PlanePatch& patch : *patches) {
    for (const PatchObservation& o : patch.observations) {
      result.num_points += static_cast<int>(o.count());
    }
  }
  motion.inertial.Report(&result);
  motion.odometry.Report(&result);
  result.thickness_after_m = MeasureThickness(problem, spline, lasers);
  return result;
}

Result<LaserCorrection> EstimateLasers(const Trajectory& map_from_lidar,
                                       const std::vector<const PackedScan*>& scans,
                                       const RefinementOptions& options) {
  // Weights are robust, against errors of the lasers too: these come out in several rounds.
  constexpr int kNumRounds = 8;
  constexpr double kHeldBack = 0.05;   // there is no drive that could bend
  constexpr double kHeldSigma = 1e-6;  // m, rad, and of what only measured motion says
  const Problem problem{scans, options};
  const PoseTable table(map_from_lidar);
  // Where points lie is the trajectory's own matter; the spline only says how planes move with it.
  const PoseSpline spline(map_from_lidar, options.knot_interval_s);
  LaserCorrection lasers(scans);
  for (int round = 0; round < kNumRounds && !lasers.empty(); ++round) {
    const auto patches = Associate(problem, table, lasers, true, false);
    if (!patches.ok()) return patches.status();
    RefinementSystem system(static_cast<int>(spline.controls().size()),
                            3 * static_cast<int>(lasers.num_nodes()));
    system.AddPatches(spline, *patches, std::vector<bool>(patches->size(), true), {});
    system.AddLaserPriors(lasers, kHeldBack);
    for (int i = 0; i < system.laser_offset(); ++i) {
      system.AddPrior(i, 0.0, 1.0 / (kHeldSigma * kHeldSigma));
    }
    const auto solution = system.Solve(options.max_solver_iterations, CloseTolerance(options));
    if (!solution.ok) return Status::NumericalFailure("the lasers' normal equations failed");
    TakeStep(solution.step, &lasers);
  }
  return lasers;
}

std::vector<RelativeMotionSigma> RelativeMotionDifference(const Trajectory& map_from_lidar,
                                                          const PoseSpline& other) {
  const auto given = [&](double seconds) {
    return *map_from_lidar.Interpolate(
        std::min(AddSeconds(other.start_ns(), seconds), map_from_lidar.end_ns()));
  };
  return RelativeMotionDifference(given, PosesOf(other),
                                  SecondsBetween(other.start_ns(), other.end_ns()));
}

}  // namespace scenecalib
