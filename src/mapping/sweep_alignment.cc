#include "sweep_alignment.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

using Matrix6d = Eigen::Matrix<double, 6, 6>;
using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix12d = MotionExpectation::Matrix12d;
using Vector12d = MotionExpectation::Vector12d;

constexpr std::size_t kChunkPoints = 256;
constexpr double kRangeSigmaM = 0.02;
constexpr double kLastKernelM = kInlierResidualM / 3.0;
/// A direction with less than this share of the planes' information is open: an even spread has a
/// third, streets leave 0.02 and more for every direction, noise of the normals 0.0005.
constexpr double kMinInformationShare = 0.005;

/// Sums over points of w J J^T with J = d(distance)/d(pose), and the same times the point's time
/// and its square: the motion's Jacobian is the pose's times the time.
struct Sums {
  Matrix6d pose = Matrix6d::Zero();
  Matrix6d pose_motion = Matrix6d::Zero();
  Matrix6d motion = Matrix6d::Zero();
  Vector6d pose_gradient = Vector6d::Zero();
  Vector6d motion_gradient = Vector6d::Zero();
  double sum_squares = 0.0;
  int num_matched = 0;
  int num_inliers = 0;

  void Add(const Sums& other) {
    pose += other.pose;
    pose_motion += other.pose_motion;
    motion += other.motion;
    pose_gradient += other.pose_gradient;
    motion_gradient += other.motion_gradient;
    sum_squares += other.sum_squares;
    num_matched += other.num_matched;
    num_inliers += other.num_inliers;
  }
};

struct Linearization {
  const VoxelPlaneMap& map;
  const std::vector<SweepPoint>& points;
  const SweepMotion& motion;
  Eigen::Matrix3d rotation;
  Eigen::Vector3d translation;
  double kernel_m;
  int first_level;
  bool with_motion;

  Sums SumChunk(std::size_t begin, std::size_t end) const {
    Sums sums;
    for (std::size_t i = begin; i < end; ++i) AddPoint(points[i], &sums);
    return sums;
  }

  void AddPoint(const SweepPoint& point, Sums* sums) const {
    const Eigen::Vector3d arm = rotation * motion.Deskew(point);
    PlaneMatch match;
    if (!map.Match(arm + translation, first_level, &match)) return;
    const double distance_m = match.distance_m;
    if (std::abs(distance_m) > 6.0 * kernel_m) return;
    ++sums->num_matched;
    if (std::abs(distance_m) < kInlierResidualM) {
      ++sums->num_inliers;
      sums->sum_squares += distance_m * distance_m;
    }
    // Geman-McClure on the distance, and less weight for thick planes.
    const double ratio = distance_m / kernel_m;
    const double robust = 1.0 / ((1.0 + ratio * ratio) * (1.0 + ratio * ratio));
    const double weight = robust / (kRangeSigmaM * kRangeSigmaM + match.sigma_m * match.sigma_m);
    Vector6d jacobian;
    jacobian << match.normal, arm.cross(match.normal);
    const Vector6d weighted = weight * jacobian;
    const Matrix6d information = weighted * jacobian.transpose();
    const Vector6d gradient = distance_m * weighted;
    sums->pose += information;
    sums->pose_gradient += gradient;
    if (!with_motion) return;
    const double seconds = point.seconds_from_mid;
    sums->pose_motion += seconds * information;
    sums->motion += (seconds * seconds) * information;
    sums->motion_gradient += seconds * gradient;
  }

  Sums SumAll() const {
    std::vector<Sums> chunks((points.size() + kChunkPoints - 1) / kChunkPoints);
    tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t i) {
      const std::size_t begin = i * kChunkPoints;
      chunks[i] = SumChunk(begin, std::min(begin + kChunkPoints, points.size()));
    });
    Sums total;
    for (const Sums& chunk : chunks) total.Add(chunk);
    return total;
  }
};

/// Information on one 3-block of the pose when the other is free, and the motion of the other block
/// that goes with a motion of this one.
struct Marginal {
  Eigen::Matrix3d information;
  Eigen::Matrix3d companion;
};

Marginal MarginalOf(const Matrix6d& information, int block) {
  const int other = 3 - block;
  Eigen::Matrix3d free = information.block<3, 3>(other, other);
  free.diagonal().array() += 1e-6 * information.trace();  // it may be open itself
  Marginal marginal;
  marginal.companion = -free.ldlt().solve(information.block<3, 3>(other, block));
  marginal.information = information.block<3, 3>(block, block) +
                         information.block<3, 3>(block, other) * marginal.companion;
  return marginal;
}

/// Finds the directions that the planes leave open and takes them out of the sums, so that noise in
/// the normals does not outweigh the expectation there.
void TakeOutOpenDirections(Sums* sums, AlignedSweep* result) {
  result->weak_translations_in_map.clear();
  result->weak_rotations_in_map.clear();
  std::vector<Vector6d> open;
  for (const int block : {0, 3}) {
    const Marginal marginal = MarginalOf(sums->pose, block);
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(marginal.information);
    const double all = sums->pose.block<3, 3>(block, block).trace();
    if (block == 0) result->translation_shares = marginal.information / std::max(all, 1e-12);
    for (int i = 0; i < 3 && eigen.eigenvalues()[i] < kMinInformationShare * all; ++i) {
      const Eigen::Vector3d direction = eigen.eigenvectors().col(i);
      Vector6d both;
      both.segment<3>(block) = direction;
      both.segment<3>(3 - block) = marginal.companion * direction;
      open.push_back(both);
      auto& weak = block == 0 ? result->weak_translations_in_map : result->weak_rotations_in_map;
      weak.push_back(direction);
    }
  }
  for (const Vector6d& direction : open) {
    const Vector6d image = sums->pose * direction;
    const double information = std::max(direction.dot(image), 1e-12);
    const Matrix6d keep = Matrix6d::Identity() - direction * image.transpose() / information;
    sums->pose = keep.transpose() * sums->pose * keep;
    sums->pose_motion = keep.transpose() * sums->pose_motion * keep;
    sums->motion = keep.transpose() * sums->motion * keep;
    sums->pose_gradient = keep.transpose() * sums->pose_gradient;
    sums->motion_gradient = keep.transpose() * sums->motion_gradient;
  }
}

Vector12d SolveStep(const Sums& sums, const MotionExpectation& expectation, const Rigid3& pose,
                    const LidarVelocity& correction, bool with_motion) {
  Matrix12d hessian = Matrix12d::Zero();
  Vector12d gradient = Vector12d::Zero();
  expectation.AddTo(pose, correction, &hessian, &gradient);
  hessian.topLeftCorner<6, 6>() += sums.pose;
  gradient.head<6>() += sums.pose_gradient;
  if (!with_motion) {
    Vector12d step = Vector12d::Zero();
    step.head<6>() = -hessian.topLeftCorner<6, 6>().ldlt().solve(gradient.head<6>());
    return step;
  }
  hessian.topRightCorner<6, 6>() += sums.pose_motion;
  hessian.bottomLeftCorner<6, 6>() += sums.pose_motion.transpose();
  hessian.bottomRightCorner<6, 6>() += sums.motion;
  gradient.tail<6>() += sums.motion_gradient;
  return -hessian.ldlt().solve(gradient);
}

}  // namespace

AlignedSweep AlignSweep(const VoxelPlaneMap& map, const std::vector<SweepPoint>& points,
                        const MotionExpectation& expectation, const Rigid3& start,
                        const AlignmentOptions& options, SweepMotion* motion) {
  constexpr double kStillM = 5e-4;
  constexpr double kStillRad = 3e-5;
  constexpr double kStill_m_s = 0.02;      // half a sweep later: 1 mm
  constexpr double kStill_rad_s = 0.0005;  // 1.5e-3 degrees
  AlignedSweep result;
  result.map_from_lidar = start;
  const bool with_motion = options.estimate_motion && motion->has_duration();
  double kernel_m = std::max(options.first_kernel_m, kLastKernelM);
  for (; result.iterations < options.max_iterations; ++result.iterations) {
    // While the pose is off by more than a fine voxel only the coarse planes mean anything.
    const int first_level = kernel_m > 0.5 * options.finest_voxel_size_m ? 2 : 0;
    Rigid3& pose = result.map_from_lidar;
    Sums sums =
        Linearization{map,      points,      *motion,    pose.RotationMatrix(), pose.translation,
                      kernel_m, first_level, with_motion}
            .SumAll();
    result.num_matched = sums.num_matched;
    result.num_inliers = sums.num_inliers;
    result.rms_m = std::sqrt(sums.sum_squares / std::max(sums.num_inliers, 1));
    TakeOutOpenDirections(&sums, &result);
    const Vector12d step = SolveStep(sums, expectation, pose, motion->correction(), with_motion);
    if (with_motion) {
      const Eigen::Quaterniond lidar_from_map = pose.rotation.conjugate();
      motion->SetCorrection(
          {motion->correction().linear_m_s + lidar_from_map * step.segment<3>(6),
           motion->correction().angular_rad_s + lidar_from_map * step.segment<3>(9)});
    }
    // Rigid3's constructor normalises: products of many small steps stay rotations.
    pose = Rigid3(ExpSo3(step.segment<3>(3)) * pose.rotation, pose.translation + step.head<3>());
    const bool still = step.head<3>().norm() < kStillM && step.segment<3>(3).norm() < kStillRad &&
                       step.segment<3>(6).norm() < kStill_m_s &&
                       step.segment<3>(9).norm() < kStill_rad_s;
    if (still && kernel_m <= kLastKernelM) {
      result.converged = true;
      break;
    }
    kernel_m = std::max(0.5 * kernel_m, kLastKernelM);
  }
  return result;
}

}  // namespace scenecalib
