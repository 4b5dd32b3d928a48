#include "scenecalib/tracking/relative_motion.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr int kSampleSize = 6;
constexpr int kMinPairs = 12;
/// Pairs that a sample's motion is scored on; the best one is refined on all.
constexpr std::size_t kMaxScored = 250;

/// Residual and its derivatives by a left perturbation of the rotation and of the direction.
struct EpipolarResidual {
  double error_px = 0.0;
  Eigen::Vector3d by_rotation_px;
  Eigen::Vector3d by_direction_px;
};

/// A point at the epipole satisfies every constraint; there the gradient vanishes as well.
constexpr double kMinScale = 1e-9;

EpipolarResidual Evaluate(const RayPair& pair, const Eigen::Quaterniond& rotation,
                          const Eigen::Vector3d& direction) {
  const Eigen::Vector3d rotated = rotation * pair.ray_in_first;
  const Eigen::Vector3d line_in_second = direction.cross(rotated);
  const Eigen::Vector3d line_in_first = rotation.conjugate() * pair.ray_in_second.cross(direction);
  const double scale = std::sqrt((pair.second_by_pixel.transpose() * line_in_second).squaredNorm() +
                                 (pair.first_by_pixel.transpose() * line_in_first).squaredNorm());
  const double inverse = 1.0 / std::max(scale, kMinScale);
  EpipolarResidual residual;
  residual.error_px = pair.ray_in_second.dot(line_in_second) * inverse;
  residual.by_direction_px = rotated.cross(pair.ray_in_second) * inverse;
  residual.by_rotation_px = rotated.cross(pair.ray_in_second.cross(direction)) * inverse;
  return residual;
}

/// Rotation that maps the first rays onto the second best, discounting pairs that disagree.
Eigen::Quaterniond FitRotation(const std::vector<RayPair>& pairs) {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  for (int iteration = 0; iteration < 8; ++iteration) {
    Eigen::Matrix3d correlation = Eigen::Matrix3d::Zero();
    for (const RayPair& pair : pairs) {
      const double angle = (rotation * pair.ray_in_first - pair.ray_in_second).norm();
      const double weight = 1.0 / (angle + 0.005);  // a smooth absolute value, radians
      correlation += weight * pair.ray_in_second * pair.ray_in_first.transpose();
    }
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(correlation,
                                                Eigen::ComputeFullU | Eigen::ComputeFullV);
    Eigen::Vector3d sign(1.0, 1.0, (svd.matrixU() * svd.matrixV().transpose()).determinant());
    rotation = Eigen::Quaterniond(svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose());
  }
  return rotation;
}

/// Direction that the chosen pairs agree with best under a given rotation: the normal of the plane
/// that their epipolar planes' normals span.
Eigen::Vector3d FitDirection(const std::vector<RayPair>& pairs, const std::vector<int>& chosen,
                             const Eigen::Quaterniond& rotation) {
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (int i : chosen) {
    const Eigen::Vector3d normal = (rotation * pairs[i].ray_in_first).cross(pairs[i].ray_in_second);
    scatter += normal * normal.transpose();
  }
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(scatter).eigenvectors().col(0);
}

/// Gauss-Newton on the five parameters over the chosen pairs; `huber_px` tames outliers.
void Refine(const std::vector<RayPair>& pairs, const std::vector<int>& chosen, int iterations,
            double huber_px, RelativeMotion* motion) {
  for (int iteration = 0; iteration < iterations; ++iteration) {
    const Eigen::Vector3d& t = motion->direction;
    const Eigen::Vector3d tangent_1 = t.unitOrthogonal();
    const Eigen::Vector3d tangent_2 = t.cross(tangent_1);
    Eigen::Matrix<double, 5, 5> normal = Eigen::Matrix<double, 5, 5>::Zero();
    Eigen::Matrix<double, 5, 1> gradient = Eigen::Matrix<double, 5, 1>::Zero();
    for (int i : chosen) {
      const EpipolarResidual r = Evaluate(pairs[i], motion->second_from_first, t);
      Eigen::Matrix<double, 5, 1> jacobian;
      jacobian << r.by_rotation_px, tangent_1.dot(r.by_direction_px),
          tangent_2.dot(r.by_direction_px);
      const double weight = std::min(1.0, huber_px / std::max(std::abs(r.error_px), 1e-12));
      normal += weight * jacobian * jacobian.transpose();
      gradient += weight * r.error_px * jacobian;
    }
    // A trace-relative damping keeps directions that the data leaves open (no translation) still.
    normal.diagonal().array() += 1e-9 * normal.trace() + 1e-12;
    Eigen::Matrix<double, 5, 1> step = -normal.ldlt().solve(gradient);
    const double size = step.norm();
    if (!std::isfinite(size)) return;
    if (size > 0.3) step *= 0.3 / size;
    motion->second_from_first = (ExpSo3(step.head<3>()) * motion->second_from_first).normalized();
    motion->direction = (t + step[3] * tangent_1 + step[4] * tangent_2).normalized();
  }
}

/// The epipolar constraint of a motion, made once for many pairs.
class EpipolarConstraint {
 public:
  explicit EpipolarConstraint(const RelativeMotion& motion)
      : essential_(Hat(motion.direction) * motion.second_from_first.toRotationMatrix()) {}

  double ErrorPx(const RayPair& pair) const {
    const Eigen::Vector3d line_in_second = essential_ * pair.ray_in_first;
    const Eigen::Vector3d line_in_first = essential_.transpose() * pair.ray_in_second;
    const double scale =
        std::sqrt((pair.second_by_pixel.transpose() * line_in_second).squaredNorm() +
                  (pair.first_by_pixel.transpose() * line_in_first).squaredNorm());
    return pair.ray_in_second.dot(line_in_second) / std::max(scale, kMinScale);
  }

 private:
  Eigen::Matrix3d essential_;
};

/// Truncated squared error (MSAC), so that among equal counts the tighter fit wins.
double Score(const std::vector<RayPair>& pairs, const RelativeMotion& motion, double max_error_px) {
  const double bound = max_error_px * max_error_px;
  const std::size_t stride = std::max<std::size_t>(1, pairs.size() / kMaxScored);
  const EpipolarConstraint constraint(motion);
  double score = 0.0;
  for (std::size_t i = 0; i < pairs.size(); i += stride) {
    const double error = constraint.ErrorPx(pairs[i]);
    score += std::min(error * error, bound);
  }
  return score;
}

std::vector<int> Inliers(const std::vector<RayPair>& pairs, const RelativeMotion& motion,
                         double max_error_px) {
  const EpipolarConstraint constraint(motion);
  std::vector<int> inliers;
  for (int i = 0; i < static_cast<int>(pairs.size()); ++i) {
    if (std::abs(constraint.ErrorPx(pairs[i])) <= max_error_px) inliers.push_back(i);
  }
  return inliers;
}

/// Gauss-Newton on all pairs that agree, whose number shrinks or grows with it.
void Polish(const std::vector<RayPair>& pairs, double max_error_px, RelativeMotion* motion) {
  for (int round = 0; round < 3; ++round) {
    const std::vector<int> inliers = Inliers(pairs, *motion, 2.0 * max_error_px);
    if (static_cast<int>(inliers.size()) < kMinPairs) break;
    Refine(pairs, inliers, 3, 0.5 * max_error_px, motion);
  }
}

/// The motion of the guess brought to these pairs; none when too few agree.
std::optional<RelativeMotion> FollowGuess(const std::vector<RayPair>& pairs,
                                          const RelativeMotion& guess,
                                          const Eigen::Quaterniond& common_rotation,
                                          double max_error_px) {
  RelativeMotion motion;
  motion.second_from_first = common_rotation;
  motion.direction = guess.direction;
  std::vector<int> some;
  const std::size_t stride = std::max<std::size_t>(1, pairs.size() / kMaxScored);
  for (std::size_t i = 0; i < pairs.size(); i += stride) some.push_back(static_cast<int>(i));
  Refine(pairs, some, 6, 0.5 * max_error_px, &motion);
  Polish(pairs, max_error_px, &motion);
  const std::size_t num_inliers = Inliers(pairs, motion, max_error_px).size();
  if (4 * num_inliers < 3 * pairs.size()) return std::nullopt;
  return motion;
}

/// The best of many samples' motions.
RelativeMotion SampleMotions(const std::vector<RayPair>& pairs,
                             const Eigen::Quaterniond& common_rotation,
                             const RelativeMotionOptions& options) {
  Random random(options.seed);
  RelativeMotion best;
  double best_score = -1.0;
  std::vector<int> sample(kSampleSize);
  for (int trial = 0; trial < options.num_samples; ++trial) {
    for (int& index : sample) index = static_cast<int>(random.Index(pairs.size()));
    RelativeMotion motion;
    motion.second_from_first = common_rotation;
    motion.direction = FitDirection(pairs, sample, common_rotation);
    Refine(pairs, sample, 6, 20.0, &motion);
    const double score = Score(pairs, motion, options.max_error_px);
    if (best_score < 0.0 || score < best_score) {
      best_score = score;
      best = motion;
    }
  }
  Polish(pairs, options.max_error_px, &best);
  return best;
}

}  // namespace

double EpipolarErrorPx(const RayPair& pair, const RelativeMotion& motion) {
  return EpipolarConstraint(motion).ErrorPx(pair);
}

std::optional<RelativeMotion> EstimateRelativeMotion(const std::vector<RayPair>& pairs,
                                                     const RelativeMotionOptions& options,
                                                     const RelativeMotion* guess) {
  if (static_cast<int>(pairs.size()) < kMinPairs) return std::nullopt;
  const Eigen::Quaterniond common_rotation = FitRotation(pairs);
  std::optional<RelativeMotion> followed;
  if (guess != nullptr) {
    followed = FollowGuess(pairs, *guess, common_rotation, options.max_error_px);
  }
  RelativeMotion best = followed ? *followed : SampleMotions(pairs, common_rotation, options);
  const std::vector<int> inliers = Inliers(pairs, best, options.max_error_px);
  best.num_inliers = static_cast<int>(inliers.size());
  if (best.num_inliers < kMinPairs) return std::nullopt;
  best.inlier.assign(pairs.size(), false);
  const EpipolarConstraint constraint(best);
  double sum = 0.0;
  for (int i : inliers) {
    best.inlier[i] = true;
    sum += std::pow(constraint.ErrorPx(pairs[i]), 2);
  }
  best.inlier_rms_px = std::sqrt(sum / best.num_inliers);
  return best;
}

}  // namespace scenecalib
