#include "feature_prediction.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <utility>

namespace scenecalib {
namespace {

/// Adds the median motion of the nearest features whose motion is known.
void BorrowMotion(const std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>>& known,
                  FeaturePrediction* predicted) {
  constexpr std::size_t kNeighbours = 5;
  if (known.size() < kNeighbours) return;
  std::vector<std::pair<double, std::size_t>> nearest(known.size());
  for (std::size_t k = 0; k < known.size(); ++k) {
    nearest[k] = {(known[k].first - predicted->pixel).squaredNorm(), k};
  }
  std::partial_sort(nearest.begin(), nearest.begin() + kNeighbours, nearest.end());
  double x[kNeighbours], y[kNeighbours];
  for (std::size_t k = 0; k < kNeighbours; ++k) {
    x[k] = known[nearest[k].second].second.x();
    y[k] = known[nearest[k].second].second.y();
  }
  std::sort(x, x + kNeighbours);
  std::sort(y, y + kNeighbours);
  predicted->pixel += Eigen::Vector2d(x[kNeighbours / 2], y[kNeighbours / 2]);
}

}  // namespace

std::vector<FeaturePrediction> PredictFeatures(const std::vector<ActiveTrack>& active,
                                               const SceneFlow* scene_flow,
                                               const PredictionTimes& times) {
  std::vector<FeaturePrediction> predicted(active.size());
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> known;  // pixel, step
  std::vector<std::size_t> unknown;
  const double last_s = SecondsBetween(times.before_previous_ns, times.previous_ns);
  const double ratio =
      last_s > 0.0 ? std::min(2.0, SecondsBetween(times.previous_ns, times.now_ns) / last_s) : 1.0;
  for (std::size_t i = 0; i < active.size(); ++i) {
    const auto& observations = active[i].track.observations;
    const std::size_t n = observations.size();
    const LiveObservation& last = active[i].place;
    predicted[i].pixel = last.pixel;
    predicted[i].affine_from_first = last.affine_from_first;
    if (active[i].num_missed > 0) continue;
    if (n < 2 || observations[n - 2].stamp_ns != times.before_previous_ns) {
      unknown.push_back(i);
      continue;
    }
    Eigen::Vector2d step = last.pixel - observations[n - 2].pixel;
    if (n > 2 &&
        SecondsBetween(observations[n - 3].stamp_ns, times.before_previous_ns) < 1.5 * last_s) {
      const double before = (observations[n - 2].pixel - observations[n - 3].pixel).norm();
      // Only steps well above the noise tell how they grow.
      if (before > 2.0) step *= std::clamp(step.norm() / before, 0.6, 1.6);
      predicted[i].affine_from_first = last.affine_from_first *
                                       observations[n - 2].affine_from_first.inverse() *
                                       last.affine_from_first;
    }
    const auto continued = scene_flow != nullptr
                               ? scene_flow->Continue(observations[n - 2].pixel, last.pixel, ratio)
                               : std::nullopt;
    predicted[i].pixel = continued ? *continued : last.pixel + ratio * step;
    known.emplace_back(last.pixel, predicted[i].pixel - last.pixel);
  }
  for (std::size_t i : unknown) {
    const auto step =
        scene_flow != nullptr ? scene_flow->Predict(predicted[i].pixel) : std::nullopt;
    if (step) {
      predicted[i].pixel += ratio * (step->center_px - predicted[i].pixel);
      predicted[i].affine_from_first = step->affine * predicted[i].affine_from_first;
    } else {
      BorrowMotion(known, &predicted[i]);
    }
  }
  return predicted;
}

}  // namespace scenecalib
