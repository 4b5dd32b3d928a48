#include "ground_segmentation.h"

#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <utility>

namespace scenecalib {
namespace {

constexpr float kNoHeight = std::numeric_limits<float>::quiet_NaN();

/// A cell's lowest returns count when this many lie within kDenseSpan_m: single returns below the
/// road are multipath.
constexpr int kDensePoints = 3;
constexpr float kDenseSpan_m = 0.06F;
/// Climbing at most this from a neighbour needs no flatness: a slope, not a step.
constexpr float kSlopeStep_m = 0.04F;
/// Of the returns up to kFlatTop_m over the cell's low, this share has to lie in its lowest
/// kFlatSpan_m for the cell to be flat.
constexpr float kFlatSpan_m = 0.08F;
constexpr float kFlatTop_m = 0.6F;
constexpr float kMinFlatShare = 0.6F;
/// In a cell where something stands a point is ground only up to this height: the foot of a wall
/// must not lift the ground before it.
constexpr float kFootTolerance_m = 0.025F;
/// The ground grows across gaps between rings of this many cells.
constexpr int kGapCells = 3;
/// Cells nearer than this to the path, in metres, may start the ground.
constexpr float kSeedRadius_m = 10.0F;

struct Cell {
  float low_m = kNoHeight;
  bool flat = false;
  bool ground = false;
};

class HeightGrid {
 public:
  HeightGrid(const std::vector<LidarReturn>& points, const GroundOptions& options)
      : points_(points), options_(options) {}

  bool Build();
  void Grow();
  bool IsGround(const LidarReturn& point) const;

 private:
  int CellOf(const Eigen::Vector3f& position_m) const {
    const int x = static_cast<int>((position_m.x() - min_m_.x()) * inverse_size_);
    const int y = static_cast<int>((position_m.y() - min_m_.y()) * inverse_size_);
    return y * width_ + x;
  }
  bool InRange(const LidarReturn& point) const {
    return (point.position_m - point.origin_m).squaredNorm() <
           options_.max_range_m * options_.max_range_m;
  }
  void Summarize(const float* heights, int count, Cell* cell) const;
  std::vector<int> Seeds() const;

  const std::vector<LidarReturn>& points_;
  const GroundOptions& options_;
  Eigen::Vector2f min_m_ = Eigen::Vector2f::Zero();
  float inverse_size_ = 1.0F;
  int width_ = 0;
  int height_ = 0;
  std::vector<Cell> cells_;
};

void HeightGrid::Summarize(const float* heights, int count, Cell* cell) const {
  int first = 0;
  while (first + kDensePoints - 1 < count &&
         heights[first + kDensePoints - 1] - heights[first] > kDenseSpan_m) {
    ++first;
  }
  if (first + kDensePoints - 1 >= count) first = 0;  // too few to tell: the lowest
  cell->low_m = heights[first];
  int in_span = 0;
  int in_top = 0;
  for (int i = first; i < count && heights[i] < cell->low_m + kFlatTop_m; ++i) {
    ++in_top;
    if (heights[i] < cell->low_m + kFlatSpan_m) ++in_span;
  }
  cell->flat = in_span >= kMinFlatShare * static_cast<float>(in_top);
}

bool HeightGrid::Build() {
  Eigen::AlignedBox2f box;
  for (const LidarReturn& point : points_) {
    if (InRange(point)) box.extend(point.position_m.head<2>());
  }
  if (box.isEmpty()) return false;
  inverse_size_ = static_cast<float>(1.0 / options_.cell_size_m);
  // One cell of margin, so that a neighbour's index never leaves its row.
  const float margin_m = static_cast<float>((kGapCells + 1) * options_.cell_size_m);
  min_m_ = box.min() - Eigen::Vector2f::Constant(margin_m);
  width_ = static_cast<int>((box.sizes().x() + 2.0F * margin_m) * inverse_size_) + 1;
  height_ = static_cast<int>((box.sizes().y() + 2.0F * margin_m) * inverse_size_) + 1;
  cells_.assign(static_cast<std::size_t>(width_) * height_, Cell());

  // Heights by cell: each cell's begin first.
  std::vector<std::size_t> begin(cells_.size() + 1, 0);
  for (const LidarReturn& point : points_) {
    if (InRange(point)) ++begin[static_cast<std::size_t>(CellOf(point.position_m)) + 1];
  }
  for (std::size_t i = 1; i < begin.size(); ++i) begin[i] += begin[i - 1];
  std::vector<std::size_t> next(begin.begin(), begin.end() - 1);
  std::vector<float> heights(begin.back());
  for (const LidarReturn& point : points_) {
    if (!InRange(point)) continue;
    heights[next[static_cast<std::size_t>(CellOf(point.position_m))]++] = point.position_m.z();
  }
  tbb::parallel_for(std::size_t{0}, cells_.size(), [&](std::size_t cell) {
    const auto count = static_cast<int>(begin[cell + 1] - begin[cell]);
    if (count == 0) return;
    float* const of_cell = heights.data() + begin[cell];
    std::sort(of_cell, of_cell + count);
    Summarize(of_cell, count, &cells_[cell]);
  });
  return true;
}

/// The flat cells around the path whose depth below the sensor is the usual one.
std::vector<int> HeightGrid::Seeds() const {
  std::vector<std::pair<int, float>> candidates;  // cell, depth below the sensor
  int last_scan = -1;
  for (const LidarReturn& point : points_) {
    if (point.scan == last_scan) continue;
    last_scan = point.scan;
    const Eigen::Vector2f path_m = point.origin_m.head<2>();
    const int radius = static_cast<int>(kSeedRadius_m * inverse_size_);
    const int center_x = static_cast<int>((path_m.x() - min_m_.x()) * inverse_size_);
    const int center_y = static_cast<int>((path_m.y() - min_m_.y()) * inverse_size_);
    for (int y = std::max(0, center_y - radius); y <= std::min(height_ - 1, center_y + radius);
         ++y) {
      for (int x = std::max(0, center_x - radius); x <= std::min(width_ - 1, center_x + radius);
           ++x) {
        const Cell& cell = cells_[y * width_ + x];
        if (std::isnan(cell.low_m) || !cell.flat || cell.low_m > point.origin_m.z()) continue;
        candidates.emplace_back(y * width_ + x, point.origin_m.z() - cell.low_m);
      }
    }
  }
  if (candidates.empty()) return {};
  // Roads are lower than what stands on them and most of what is near: the usual depth is the
  // median of the candidates' deeper half.
  std::vector<float> depths(candidates.size());
  for (std::size_t i = 0; i < depths.size(); ++i) depths[i] = candidates[i].second;
  const std::size_t rank = depths.size() * 3 / 4;
  std::nth_element(depths.begin(), depths.begin() + rank, depths.end());
  const float usual_m = depths[rank];
  std::vector<int> seeds;
  for (const auto& [cell, depth_m] : candidates) {
    if (std::abs(depth_m - usual_m) < options_.max_step_m) seeds.push_back(cell);
  }
  std::sort(seeds.begin(), seeds.end());
  seeds.erase(std::unique(seeds.begin(), seeds.end()), seeds.end());
  return seeds;
}

void HeightGrid::Grow() {
  const std::vector<int> seeds = Seeds();
  std::deque<int> front(seeds.begin(), seeds.end());
  for (const int seed : seeds) cells_[seed].ground = true;
  while (!front.empty()) {
    const int from = front.front();
    front.pop_front();
    const int from_x = from % width_;
    const int from_y = from / width_;
    for (int dy = -kGapCells; dy <= kGapCells; ++dy) {
      for (int dx = -kGapCells; dx <= kGapCells; ++dx) {
        const int x = from_x + dx;
        const int y = from_y + dy;
        if (x < 0 || y < 0 || x >= width_ || y >= height_) continue;
        Cell& cell = cells_[y * width_ + x];
        if (cell.ground || std::isnan(cell.low_m)) continue;
        const float step_m = std::abs(cell.low_m - cells_[from].low_m);
        const float distance_cells = static_cast<float>(std::max(std::abs(dx), std::abs(dy)));
        const bool slope = step_m <= kSlopeStep_m * distance_cells;
        const bool flat_step = cell.flat && step_m <= options_.max_step_m;
        if (!slope && !flat_step) continue;
        cell.ground = true;
        front.push_back(y * width_ + x);
      }
    }
  }
}

bool HeightGrid::IsGround(const LidarReturn& point) const {
  if (!InRange(point)) return false;
  const int center = CellOf(point.position_m);
  // A kerb's face lies between the heights of the cells around it.
  float lowest_m = std::numeric_limits<float>::max();
  float highest_m = std::numeric_limits<float>::lowest();
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const Cell& cell = cells_[center + dy * width_ + dx];
      if (!cell.ground) continue;
      lowest_m = std::min(lowest_m, cell.low_m);
      highest_m = std::max(highest_m, cell.low_m);
    }
  }
  const float tolerance_m = static_cast<float>(options_.max_height_above_low_m);
  const float above_m = cells_[center].flat ? tolerance_m : std::min(tolerance_m, kFootTolerance_m);
  return point.position_m.z() > lowest_m - tolerance_m &&
         point.position_m.z() < highest_m + above_m;
}

}  // namespace

int SegmentGround(const std::vector<LidarReturn>& points, const GroundOptions& options,
                  std::vector<PointLabel>* labels) {
  HeightGrid grid(points, options);
  if (!grid.Build()) return 0;
  grid.Grow();
  tbb::parallel_for(std::size_t{0}, points.size(), [&](std::size_t i) {
    if (grid.IsGround(points[i])) (*labels)[i] = PointLabel::kGround;
  });
  return static_cast<int>(std::count(labels->begin(), labels->end(), PointLabel::kGround));
}

}  // namespace scenecalib
