#include "plane_fit.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

namespace scenecalib {
namespace {

constexpr int kMaxSamples = 200;
constexpr int kMaxTrials = 24;
constexpr int kRefinements = 2;
/// Inliers spread less than this share of their length across it: a line fixes no plane.
constexpr float kMinAspect = 0.05F;

/// Inliers only, moments about the first point.
template <typename IsInlier>
std::optional<PlaneFit> PrincipalComponents(const std::vector<Eigen::Vector3f>& points,
                                            const IsInlier& is_inlier) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
  int count = 0;
  for (const Eigen::Vector3f& point : points) {
    if (!is_inlier(point)) continue;
    const Eigen::Vector3d d = (point - points.front()).cast<double>();
    sum += d;
    squares.noalias() += d * d.transpose();
    ++count;
  }
  if (count < 3) return std::nullopt;
  const Eigen::Vector3d mean = sum / count;
  const Eigen::Matrix3d covariance = squares / count - mean * mean.transpose();
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  solver.compute(covariance);
  PlaneFit fit;
  fit.center_m = points.front() + mean.cast<float>();
  fit.normal = solver.eigenvectors().col(0).cast<float>().normalized();
  fit.axis_u = solver.eigenvectors().col(2).cast<float>().normalized();
  fit.axis_v = fit.normal.cross(fit.axis_u);
  const Eigen::Vector3d variances = solver.eigenvalues().cwiseMax(0.0);
  fit.thickness_m = static_cast<float>(std::sqrt(variances[0]));
  fit.spread_v_m = static_cast<float>(std::sqrt(variances[1]));
  if (fit.spread_v_m < kMinAspect * std::sqrt(variances[2])) return std::nullopt;
  fit.num_inliers = count;
  return fit;
}

}  // namespace

std::optional<PlaneFit> FitPlaneToAll(const std::vector<Eigen::Vector3f>& points) {
  if (points.size() < 3) return std::nullopt;
  return PrincipalComponents(points, [](const Eigen::Vector3f&) { return true; });
}

std::optional<PlaneFit> FitPlane(const std::vector<Eigen::Vector3f>& points,
                                 float inlier_distance_m, int min_inliers, Random random) {
  if (static_cast<int>(points.size()) < std::max(3, min_inliers)) return std::nullopt;
  std::vector<Eigen::Vector3f> samples;
  const std::size_t stride = (points.size() + kMaxSamples - 1) / kMaxSamples;
  for (std::size_t i = 0; i < points.size(); i += stride) samples.push_back(points[i]);

  Eigen::Vector3f best_normal = Eigen::Vector3f::Zero();
  Eigen::Vector3f best_point_m = Eigen::Vector3f::Zero();
  float best_score = 0.0F;
  const float gate = inlier_distance_m * inlier_distance_m;
  for (int trial = 0; trial < kMaxTrials; ++trial) {
    const Eigen::Vector3f& a = samples[random.Index(samples.size())];
    const Eigen::Vector3f& b = samples[random.Index(samples.size())];
    const Eigen::Vector3f& c = samples[random.Index(samples.size())];
    Eigen::Vector3f normal = (b - a).cross(c - a);
    const float length = normal.norm();
    if (length < 1e-8F) continue;
    normal /= length;
    float score = 0.0F;  // truncated quadratic (MSAC): nearer inliers count more
    for (const Eigen::Vector3f& sample : samples) {
      const float distance = normal.dot(sample - a);
      score += std::max(0.0F, gate - distance * distance);
    }
    if (score > best_score) {
      best_score = score;
      best_normal = normal;
      best_point_m = a;
    }
  }
  if (best_score <= 0.0F) return std::nullopt;

  std::optional<PlaneFit> fit;
  for (int i = 0; i < kRefinements; ++i) {
    fit = PrincipalComponents(points, [&](const Eigen::Vector3f& point) {
      return std::abs(best_normal.dot(point - best_point_m)) <= inlier_distance_m;
    });
    if (!fit || fit->num_inliers < min_inliers) return std::nullopt;
    best_normal = fit->normal;
    best_point_m = fit->center_m;
  }
  return fit;
}

}  // namespace scenecalib
