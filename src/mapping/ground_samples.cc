#include "ground_samples.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace scenecalib {
namespace {

/// A column whose heights spread more than this holds a step.
constexpr float kMaxFlatSpread_m = 0.06F;
constexpr float kSlice_m = 0.04F;
/// Returns of a flat within a slice: thicker than their noise, thinner than the slice.
constexpr float kLayer_m = 0.02F;
/// A flat's layer holds at least this share of the returns of the column's densest.
constexpr double kMinLayerShare = 0.6;
/// Normals come from the samples within this many columns.
constexpr int kNormalReach = 3;
constexpr int kMinNormalSamples = 5;
constexpr double kMinAspect = 0.15;
/// Samples that leave their plane by more than this (RMS) hold a step; then those within the rise
/// count.
constexpr double kMaxRoughness_m = 0.012;
constexpr float kMaxRise_m = 0.04F;
/// A mean of fewer returns than this is not averaged enough to tell anything.
constexpr int kMinReturns = 2;

struct Column {
  int x = 0;
  int y = 0;
  int begin = 0;  // its samples
  int end = 0;
};

struct KeyedPoint {
  int x = 0;
  int y = 0;
  Eigen::Vector3f position_m;
  int index = 0;
  bool operator<(const KeyedPoint& other) const {
    if (y != other.y) return y < other.y;
    if (x != other.x) return x < other.x;
    if (position_m.z() != other.position_m.z()) return position_m.z() < other.position_m.z();
    return index < other.index;
  }
};

std::vector<KeyedPoint> SortIntoColumns(const std::vector<LidarReturn>& points,
                                        const std::vector<PointLabel>& labels,
                                        double column_size_m) {
  std::vector<KeyedPoint> sorted;
  const float inverse_size = static_cast<float>(1.0 / column_size_m);
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (labels[i] != PointLabel::kGround) continue;
    KeyedPoint keyed;
    keyed.position_m = points[i].position_m;
    keyed.x = static_cast<int>(std::floor(keyed.position_m.x() * inverse_size));
    keyed.y = static_cast<int>(std::floor(keyed.position_m.y() * inverse_size));
    keyed.index = static_cast<int>(i);
    sorted.push_back(keyed);
  }
  tbb::parallel_sort(sorted.begin(), sorted.end());
  return sorted;
}

/// The mean of the returns [begin, end), sorted by height, as one sample.
void AppendMean(const KeyedPoint* begin, const KeyedPoint* end,
                std::vector<GroundSample>* samples) {
  if (end - begin < kMinReturns) return;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const KeyedPoint* point = begin; point != end; ++point) {
    sum += point->position_m.cast<double>();
  }
  GroundSample sample;
  sample.position_m = (sum / static_cast<double>(end - begin)).cast<float>();
  sample.num_returns = static_cast<int>(end - begin);
  samples->push_back(sample);
}

/// A column with a step: the lowest and the highest of its layers that hold many returns. Those
/// from the step's face are spread over all heights; they would lift the road before it.
void AverageStep(const KeyedPoint* begin, const KeyedPoint* end,
                 std::vector<GroundSample>* samples) {
  using Layer = std::pair<const KeyedPoint*, const KeyedPoint*>;
  std::vector<Layer> layers;  // the densest of every slice
  for (const KeyedPoint* first = begin; first != end;) {
    const KeyedPoint* last = first;
    while (last != end && last->position_m.z() - first->position_m.z() <= kSlice_m) ++last;
    Layer densest(first, first);
    const KeyedPoint* top = first;
    for (const KeyedPoint* bottom = first; bottom != last; ++bottom) {
      while (top != last && top->position_m.z() - bottom->position_m.z() <= kLayer_m) ++top;
      if (top - bottom > densest.second - densest.first) densest = {bottom, top};
    }
    layers.push_back(densest);
    first = last;
  }
  const auto size = [](const Layer& layer) { return layer.second - layer.first; };
  std::ptrdiff_t largest = 0;
  for (const Layer& layer : layers) largest = std::max(largest, size(layer));
  const auto is_flat = [&](const Layer& layer) {
    return static_cast<double>(size(layer)) >= kMinLayerShare * static_cast<double>(largest);
  };
  const auto lowest = std::find_if(layers.begin(), layers.end(), is_flat);
  const auto highest = std::find_if(layers.rbegin(), layers.rend(), is_flat);
  AppendMean(lowest->first, lowest->second, samples);
  if (*highest != *lowest) AppendMean(highest->first, highest->second, samples);
}

/// One sample per column, or several of a column with a step. `sorted` is by height.
void AverageColumn(const KeyedPoint* begin, const KeyedPoint* end,
                   std::vector<GroundSample>* samples) {
  const auto count = end - begin;
  // The spread without the outermost tenths: noise has tails, a step has mass.
  const float low_m = begin[count / 10].position_m.z();
  const float high_m = begin[count - 1 - count / 10].position_m.z();
  if (high_m - low_m > kMaxFlatSpread_m) {
    AverageStep(begin, end, samples);
  } else {
    AppendMean(begin, end, samples);
  }
}

class NormalEstimator {
 public:
  NormalEstimator(const std::vector<Column>& columns, const std::vector<GroundSample>& samples)
      : columns_(columns), samples_(samples) {}

  /// Sets the normal to the smallest principal component of the samples around. Where they do not
  /// lie on one plane (a step), only those about as high as the sample count: the normals of a
  /// pavement must not lean towards its kerb.
  void Estimate(const Column& center, GroundSample* sample) const {
    if (Fit(center, std::numeric_limits<float>::max(), sample) < kMaxRoughness_m) return;
    Fit(center, kMaxRise_m, sample);
  }

  void set_column_size_m(double size_m) { column_size_m_ = static_cast<float>(size_m); }

 private:
  /// From the samples that are at most max_rise_m higher or lower; returns their RMS distance from
  /// the plane.
  double Fit(const Column& center, float max_rise_m, GroundSample* sample) const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
    int count = 0;
    const float reach_m = kNormalReach * column_size_m_;
    for (int dy = -kNormalReach; dy <= kNormalReach; ++dy) {
      for (auto column = FirstInRow(center.x - kNormalReach, center.y + dy);
           column != columns_.end() && column->y == center.y + dy &&
           column->x <= center.x + kNormalReach;
           ++column) {
        for (int k = column->begin; k < column->end; ++k) {
          const Eigen::Vector3f offset = samples_[k].position_m - sample->position_m;
          if (offset.squaredNorm() > reach_m * reach_m || std::abs(offset.z()) > max_rise_m) {
            continue;
          }
          const Eigen::Vector3d d = offset.cast<double>();
          sum += d;
          squares += d * d.transpose();
          ++count;
        }
      }
    }
    if (count < kMinNormalSamples) return 0.0;
    const Eigen::Vector3d mean = sum / count;
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
    solver.computeDirect(squares / count - mean * mean.transpose());
    // Samples on a line (a single ring far off) say nothing about the slope across it.
    if (solver.eigenvalues()[1] < kMinAspect * kMinAspect * solver.eigenvalues()[2]) return 0.0;
    Eigen::Vector3d normal = solver.eigenvectors().col(0);
    if (normal.z() < 0.0) normal = -normal;
    sample->normal = normal.cast<float>();
    sample->has_normal = true;
    return std::sqrt(std::max(0.0, solver.eigenvalues()[0]));
  }

  std::vector<Column>::const_iterator FirstInRow(int x, int y) const {
    return std::lower_bound(columns_.begin(), columns_.end(), std::pair<int, int>(y, x),
                            [](const Column& column, const std::pair<int, int>& yx) {
                              return std::pair<int, int>(column.y, column.x) < yx;
                            });
  }

  const std::vector<Column>& columns_;
  const std::vector<GroundSample>& samples_;
  float column_size_m_ = 0.1F;
};

}  // namespace

std::vector<GroundSample> AverageGround(const std::vector<LidarReturn>& points,
                                        const std::vector<PointLabel>& labels,
                                        double column_size_m) {
  const std::vector<KeyedPoint> sorted = SortIntoColumns(points, labels, column_size_m);
  std::vector<Column> columns;
  std::vector<GroundSample> samples;
  for (std::size_t begin = 0; begin < sorted.size();) {
    std::size_t end = begin;
    while (end < sorted.size() && sorted[end].x == sorted[begin].x &&
           sorted[end].y == sorted[begin].y) {
      ++end;
    }
    Column column{sorted[begin].x, sorted[begin].y, static_cast<int>(samples.size()), 0};
    AverageColumn(sorted.data() + begin, sorted.data() + end, &samples);
    column.end = static_cast<int>(samples.size());
    if (column.end > column.begin) columns.push_back(column);
    begin = end;
  }
  std::vector<GroundSample> normals = samples;
  NormalEstimator estimator(columns, samples);
  estimator.set_column_size_m(column_size_m);
  tbb::parallel_for(std::size_t{0}, columns.size(), [&](std::size_t c) {
    for (int k = columns[c].begin; k < columns[c].end; ++k) {
      GroundSample estimated = samples[k];
      estimator.Estimate(columns[c], &estimated);
      normals[k] = estimated;
    }
  });
  return normals;
}

}  // namespace scenecalib
