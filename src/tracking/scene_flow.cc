#include "scenecalib/tracking/scene_flow.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace scenecalib {
namespace {

/// Nearest features that a pixel's inverse range is fitted to.
constexpr std::size_t kNumSupports = 14;
/// Cells of the features' index across the image.
constexpr double kCellsAcross = 24.0;
/// How far a feature may be off its epipolar line and still be taken for a part of the scene.
constexpr double kMaxAcrossPx = 1.5;

}  // namespace

std::optional<SceneFlow> SceneFlow::Estimate(
    const CameraModel& model,
    const std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>>& pixels, double min_motion_px,
    const RelativeMotionOptions& options, const SceneFlow* previous) {
  std::vector<RayPair> pairs;
  std::vector<Eigen::Vector2d> before;
  std::vector<double> motions_px;
  for (const auto& [first_px, second_px] : pixels) {
    UnprojectionJacobians first, second;
    const auto first_ray = model.Unproject(first_px, &first);
    const auto second_ray = model.Unproject(second_px, &second);
    if (!first_ray || !second_ray) continue;
    pairs.push_back({*first_ray, *second_ray, first.ray_by_pixel, second.ray_by_pixel});
    before.push_back(first_px);
    motions_px.push_back((second_px - first_px).norm());
  }
  if (motions_px.size() < 2 * kNumSupports) return std::nullopt;
  const auto middle = motions_px.begin() + static_cast<std::ptrdiff_t>(motions_px.size() / 2);
  std::nth_element(motions_px.begin(), middle, motions_px.end());
  if (*middle < min_motion_px) return std::nullopt;
  auto motion =
      EstimateRelativeMotion(pairs, options, previous != nullptr ? &previous->motion_ : nullptr);
  if (!motion || 2 * motion->num_inliers < static_cast<int>(pairs.size())) return std::nullopt;

  SceneFlow flow(&model, std::move(*motion));
  double balance = 0.0;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    if (!flow.motion_.inlier[i]) continue;
    Support support;
    support.pixel = before[i];
    support.ray = pairs[i].ray_in_first;
    support.weight = flow.motion_.direction.cross(pairs[i].ray_in_second).squaredNorm();
    if (support.weight < 1e-4) continue;  // within half a degree of the direction of motion
    support.inverse_range = flow.InverseRange(
        flow.motion_.second_from_first * pairs[i].ray_in_first, pairs[i].ray_in_second);
    balance += support.weight * support.inverse_range;
    flow.supports_.push_back(support);
  }
  if (flow.supports_.size() < kNumSupports) return std::nullopt;
  if (balance < 0.0) {  // things lie in front: that decides the direction's sign
    flow.motion_.direction = -flow.motion_.direction;
    for (Support& support : flow.supports_) support.inverse_range = -support.inverse_range;
  }
  flow.IndexSupports();
  return flow;
}

double SceneFlow::InverseRange(const Eigen::Vector3d& rotated_ray,
                               const Eigen::Vector3d& ray_in_second) const {
  const Eigen::Vector3d across = motion_.direction.cross(ray_in_second);
  // rotated + inverse_range * direction is parallel to the second ray.
  return -across.dot(rotated_ray.cross(ray_in_second)) / std::max(across.squaredNorm(), 1e-12);
}

void SceneFlow::IndexSupports() {
  cell_px_ = std::max(8.0, model_->width_px() / kCellsAcross);
  columns_ = static_cast<int>(model_->width_px() / cell_px_) + 1;
  rows_ = static_cast<int>(model_->height_px() / cell_px_) + 1;
  const auto cell = [this](const Support& support) {
    const int column = std::clamp(static_cast<int>(support.pixel.x() / cell_px_), 0, columns_ - 1);
    const int row = std::clamp(static_cast<int>(support.pixel.y() / cell_px_), 0, rows_ - 1);
    return static_cast<std::size_t>(row * columns_ + column);
  };
  std::stable_sort(supports_.begin(), supports_.end(),
                   [&cell](const Support& a, const Support& b) { return cell(a) < cell(b); });
  cell_begin_.assign(static_cast<std::size_t>(columns_ * rows_) + 1, 0);
  for (const Support& support : supports_) ++cell_begin_[cell(support) + 1];
  for (std::size_t i = 1; i < cell_begin_.size(); ++i) cell_begin_[i] += cell_begin_[i - 1];
}

/// The supports of the smallest square of cells around the pixel that holds enough of them, and of
/// one ring more.
void SceneFlow::GatherNearest(const Eigen::Vector2d& pixel,
                              std::vector<std::pair<double, std::size_t>>* nearest) const {
  const int column = static_cast<int>(pixel.x() / cell_px_);
  const int row = static_cast<int>(pixel.y() / cell_px_);
  int enough = -1;
  for (int ring = 0; enough < 0 || ring <= enough; ++ring) {
    for (int y = row - ring; y <= row + ring; ++y) {
      if (y < 0 || y >= rows_) continue;
      const bool is_whole_row = y == row - ring || y == row + ring;
      for (int x = column - ring; x <= column + ring;
           x += is_whole_row || ring == 0 ? 1 : 2 * ring) {
        if (x < 0 || x >= columns_) continue;
        const auto cell = static_cast<std::size_t>(y * columns_ + x);
        for (std::size_t i = cell_begin_[cell]; i < cell_begin_[cell + 1]; ++i) {
          nearest->emplace_back((supports_[i].pixel - pixel).squaredNorm(), i);
        }
      }
    }
    if (enough < 0 && nearest->size() >= kNumSupports) enough = ring + 1;
    if (ring > columns_ + rows_) break;
  }
}

std::optional<Eigen::Vector3d> SceneFlow::FitInverseRange(const Eigen::Vector2d& pixel) const {
  thread_local std::vector<std::pair<double, std::size_t>> nearest;  // of this call alone
  nearest.clear();
  GatherNearest(pixel, &nearest);
  if (nearest.size() < kNumSupports) return std::nullopt;
  const auto end = nearest.begin() + kNumSupports;
  std::nth_element(nearest.begin(), end - 1, nearest.end());
  std::sort(nearest.begin(), end);
  Eigen::Vector3d fit = Eigen::Vector3d::Zero();
  double scale = 0.0;
  for (int round = 0; round < 3; ++round) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    double error_sum = 0.0;
    for (auto it = nearest.begin(); it != end; ++it) {
      const Support& support = supports_[it->second];
      const double error = std::abs(support.inverse_range - fit.dot(support.ray));
      // From the second round on, features of another surface lose their say.
      const double robust = round == 0 ? 1.0 : scale / (scale + error);
      error_sum += error;
      const Eigen::Vector3d weighted = support.weight * robust * support.ray;
      normal.noalias() += weighted * support.ray.transpose();
      right += weighted * support.inverse_range;
    }
    scale = error_sum / kNumSupports + 1e-6;
    normal.diagonal().array() += 1e-5 * normal.trace();
    fit = normal.inverse() * right;
  }
  if (!fit.allFinite()) return std::nullopt;
  return fit;
}

std::optional<PatchWarp> SceneFlow::Predict(const Eigen::Vector2d& pixel) const {
  const auto fit = FitInverseRange(pixel);
  if (!fit) return std::nullopt;
  UnprojectionJacobians unprojection;
  const auto ray = model_->Unproject(pixel, &unprojection);
  if (!ray) return std::nullopt;
  Eigen::Vector3d point = motion_.second_from_first * *ray;
  Eigen::Matrix<double, 3, 2> point_by_pixel =
      motion_.second_from_first.toRotationMatrix() * unprojection.ray_by_pixel;
  const double inverse_range = fit->dot(*ray);
  if (inverse_range > 0.0) {
    point += inverse_range * motion_.direction;
    point_by_pixel += motion_.direction * (fit->transpose() * unprojection.ray_by_pixel);
  }
  ProjectionJacobians projection;
  const auto center = model_->Project(point, &projection);
  if (!center) return std::nullopt;
  PatchWarp warp;
  warp.center_px = *center;
  warp.affine = projection.pixel_by_point * point_by_pixel;
  if (!(warp.affine.determinant() > 0.05 && warp.affine.determinant() < 20.0)) return std::nullopt;
  return warp;
}

std::optional<Eigen::Vector2d> SceneFlow::Continue(const Eigen::Vector2d& before_px,
                                                   const Eigen::Vector2d& after_px,
                                                   double ratio) const {
  const auto before = model_->Unproject(before_px);
  const auto after = model_->Unproject(after_px);
  if (!before || !after) return std::nullopt;
  const Eigen::Vector3d rotated = motion_.second_from_first * *before;
  const double inverse_range = InverseRange(rotated, *after);
  if (inverse_range < 0.0) return std::nullopt;
  const Eigen::Vector3d point = rotated + inverse_range * motion_.direction;
  const auto seen = model_->Project(point);
  if (!seen || (*seen - after_px).norm() > kMaxAcrossPx) return std::nullopt;
  const Eigen::AngleAxisd turn(motion_.second_from_first);
  return model_->Project(Eigen::AngleAxisd(ratio * turn.angle(), turn.axis()) *
                             (point.norm() * *after) +
                         ratio * inverse_range * motion_.direction);
}

}  // namespace scenecalib
