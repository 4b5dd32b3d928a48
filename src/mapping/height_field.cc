#include "height_field.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace scenecalib {
namespace {

/// Samples steeper than this (25 degrees) lie on a kerb's face: no slope, and no height, of a
/// height field.
constexpr float kMinNormalZ = 0.9F;
/// Returns at which a sample's mean counts half of what it can count.
constexpr float kHalfWeightReturns = 4.0F;
/// Slopes are averaged over this many cells around a vertex; vertices without any look farther.
constexpr int kSlopeReach = 3;
constexpr int kFarSlopeReach = 10;
/// Jumps across an edge beyond its slope that halve and quarter its conductance, first against the
/// samples' own heights, then against the solution's.
constexpr float kRoughStep_m = 0.04F;
constexpr float kStep_m = 0.008F;
constexpr int kSolves = 3;
constexpr float kMinConductance = 1e-3F;
constexpr int kMaxIterations = 200;
/// Of the first residual, in the diagonal's norm; the solves before the last only have to find the
/// steps.
constexpr double kRoughTolerance = 0.03;
constexpr double kTolerance = 0.003;

/// The lattice with everything that the equations are made of. Edge e of vertex v is the one
/// towards x + 1 (c_x) or y + 1 (c_y).
class HeightSolver {
 public:
  HeightSolver(int width, int height, float cell_m)
      : width_(width),
        height_(height),
        cell_m_(cell_m),
        weight_(Size(), 0.0F),
        z_(Size(), 0.0F),
        slope_x_(Size(), 0.0F),
        slope_y_(Size(), 0.0F) {}

  void AddSamples(const std::vector<GroundSample>& samples, const Eigen::Vector2f& origin_m,
                  const HeightFieldOptions& options);
  void Solve();
  std::vector<float> Heights() const;

 private:
  std::size_t Size() const { return static_cast<std::size_t>(width_) * height_; }
  void Close(int reach);
  void SpreadSlopes(const std::vector<float>& counts);
  void FillHeights();
  void SetConductances(float step_m);
  void Multiply(const std::vector<float>& x, std::vector<float>* y) const;
  void Relax(double tolerance);
  template <typename Visit>
  void VisitEdges(const Visit& visit) const;

  int width_;
  int height_;
  float cell_m_;
  std::vector<char> covered_;
  std::vector<float> weight_;  // of the data term, by vertex
  std::vector<float> data_;    // weighted mean of the samples' heights at the vertex
  std::vector<float> z_;
  std::vector<float> slope_x_;
  std::vector<float> slope_y_;
  std::vector<float> c_x_;
  std::vector<float> c_y_;
  std::vector<float> diagonal_;
};

/// Sliding-window sums along rows, then columns: a box blur of half-width `reach`.
void BoxSum(int width, int height, int reach, std::vector<float>* values) {
  std::vector<double> prefix(std::max(width, height) + 1, 0.0);
  const auto blur = [&](float* first, int count, int stride) {
    for (int i = 0; i < count; ++i) prefix[i + 1] = prefix[i] + first[i * stride];
    for (int i = 0; i < count; ++i) {
      first[i * stride] = static_cast<float>(prefix[std::min(count, i + reach + 1)] -
                                             prefix[std::max(0, i - reach)]);
    }
  };
  for (int y = 0; y < height; ++y) blur(values->data() + y * width, width, 1);
  for (int x = 0; x < width; ++x) blur(values->data() + x, height, width);
}

void HeightSolver::AddSamples(const std::vector<GroundSample>& samples,
                              const Eigen::Vector2f& origin_m, const HeightFieldOptions& options) {
  std::vector<double> heights(Size(), 0.0);
  std::vector<float> counts(Size(), 0.0F);
  covered_.assign(Size(), 0);
  const auto full_weight =
      static_cast<float>(options.sample_area_m2 / (options.smoothing_m * options.smoothing_m));
  for (const GroundSample& sample : samples) {
    const Eigen::Vector2f place = (sample.position_m.head<2>() - origin_m) / cell_m_;
    const int x = static_cast<int>(std::lround(place.x()));
    const int y = static_cast<int>(std::lround(place.y()));
    if (x < 0 || y < 0 || x >= width_ || y >= height_) continue;
    const int v = y * width_ + x;
    covered_[v] = 1;
    if (sample.normal.z() < kMinNormalZ) continue;
    Eigen::Vector2f slope = Eigen::Vector2f::Zero();
    if (sample.has_normal) {
      slope = -sample.normal.head<2>() / sample.normal.z();
      slope_x_[v] += slope.x();
      slope_y_[v] += slope.y();
      counts[v] += 1.0F;
    }
    const auto returns = static_cast<float>(sample.num_returns);
    const float weight = full_weight * returns / (returns + kHalfWeightReturns);
    const Eigen::Vector2f off_m =
        cell_m_ * (Eigen::Vector2f(static_cast<float>(x), static_cast<float>(y)) - place);
    heights[v] += weight * (sample.position_m.z() + slope.dot(off_m));
    weight_[v] += weight;
  }
  data_.assign(Size(), 0.0F);
  for (std::size_t v = 0; v < Size(); ++v) {
    if (weight_[v] > 0.0F) data_[v] = static_cast<float>(heights[v] / weight_[v]);
  }
  Close(std::max(1, static_cast<int>(std::ceil(0.5 * options.max_hole_m / cell_m_))));
  SpreadSlopes(counts);
  FillHeights();
}

/// Morphological closing of the coverage: small gaps are bridged, the border does not move.
void HeightSolver::Close(int reach) {
  const int full = (2 * reach + 1) * (2 * reach + 1);
  std::vector<float> sums(Size());
  for (std::size_t v = 0; v < Size(); ++v) sums[v] = covered_[v] ? 1.0F : 0.0F;
  BoxSum(width_, height_, reach, &sums);
  for (float& sum : sums) sum = sum > 0.5F ? 1.0F : 0.0F;
  BoxSum(width_, height_, reach, &sums);
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      // The lattice's border sees a cut window: there only what has data is covered.
      const bool whole = x >= reach && y >= reach && x < width_ - reach && y < height_ - reach;
      char& covered = covered_[y * width_ + x];
      covered = covered || (whole && sums[y * width_ + x] > static_cast<float>(full) - 0.5F);
    }
  }
}

void HeightSolver::SpreadSlopes(const std::vector<float>& counts) {
  std::vector<float> far_x = slope_x_;
  std::vector<float> far_y = slope_y_;
  std::vector<float> far_counts = counts;
  std::vector<float> near_counts = counts;
  for (auto* values : {&slope_x_, &slope_y_, &near_counts}) {
    BoxSum(width_, height_, kSlopeReach, values);
  }
  for (auto* values : {&far_x, &far_y, &far_counts}) {
    BoxSum(width_, height_, kFarSlopeReach, values);
  }
  for (std::size_t v = 0; v < Size(); ++v) {
    const bool has_near = near_counts[v] > 0.5F;
    const float count = has_near ? near_counts[v] : std::max(1.0F, far_counts[v]);
    slope_x_[v] = (has_near ? slope_x_[v] : far_x[v]) / count;
    slope_y_[v] = (has_near ? slope_y_[v] : far_y[v]) / count;
  }
}

/// Heights to start from: the data, and between it what grows from it along the slopes.
void HeightSolver::FillHeights() {
  std::vector<char> known(Size(), 0);
  std::vector<int> front;
  for (std::size_t v = 0; v < Size(); ++v) {
    if (weight_[v] <= 0.0F) continue;
    z_[v] = data_[v];
    known[v] = 1;
    front.push_back(static_cast<int>(v));
  }
  constexpr std::array<int, 4> kDx = {1, -1, 0, 0};
  constexpr std::array<int, 4> kDy = {0, 0, 1, -1};
  std::vector<int> next;
  std::vector<char> known_before;
  while (!front.empty()) {
    known_before = known;
    next.clear();
    for (const int from : front) {
      for (int k = 0; k < 4; ++k) {
        const int x = from % width_ + kDx[k];
        const int y = from / width_ + kDy[k];
        if (x < 0 || y < 0 || x >= width_ || y >= height_) continue;
        const int v = y * width_ + x;
        if (known[v] || !covered_[v]) continue;
        float sum = 0.0F;
        float count = 0.0F;
        for (int n = 0; n < 4; ++n) {
          const int nx = x + kDx[n];
          const int ny = y + kDy[n];
          if (nx < 0 || ny < 0 || nx >= width_ || ny >= height_) continue;
          const int u = ny * width_ + nx;
          if (!known_before[u]) continue;
          sum += z_[u] - cell_m_ * (static_cast<float>(kDx[n]) * slope_x_[v] +
                                    static_cast<float>(kDy[n]) * slope_y_[v]);
          count += 1.0F;
        }
        z_[v] = sum / count;
        known[v] = 1;
        next.push_back(v);
      }
    }
    front.swap(next);
  }
  // Covered places that no height reaches (nothing but steep samples) stay empty.
  for (std::size_t v = 0; v < Size(); ++v) covered_[v] = covered_[v] && known[v];
}

/// Calls visit(v, u, slope step, conductance of v's edge to u) for all edges between covered
/// vertices.
template <typename Visit>
void HeightSolver::VisitEdges(const Visit& visit) const {
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      const int v = y * width_ + x;
      if (!covered_[v]) continue;
      if (x + 1 < width_ && covered_[v + 1]) {
        visit(v, v + 1, 0.5F * cell_m_ * (slope_x_[v] + slope_x_[v + 1]), c_x_[v], true);
      }
      if (y + 1 < height_ && covered_[v + width_]) {
        const int u = v + width_;
        visit(v, u, 0.5F * cell_m_ * (slope_y_[v] + slope_y_[u]), c_y_[v], false);
      }
    }
  }
}

void HeightSolver::SetConductances(float step_m) {
  c_x_.assign(Size(), 0.0F);
  c_y_.assign(Size(), 0.0F);
  diagonal_ = weight_;
  VisitEdges([&](int v, int u, float step, float /*conductance*/, bool along_x) {
    const float jump = (z_[u] - z_[v] - step) / step_m;
    const float fall = 1.0F / (1.0F + jump * jump);
    const float c = std::max(kMinConductance, fall * fall);
    (along_x ? c_x_ : c_y_)[v] = c;
    diagonal_[v] += c;
    diagonal_[u] += c;
  });
}

/// y = A x. Uncovered vertices have neither weight nor conductance, nor has an edge that would
/// leave the lattice: a row's last vertex may as well be taken for the neighbour of the next row's
/// first.
void HeightSolver::Multiply(const std::vector<float>& x, std::vector<float>* y) const {
  const auto at = [&](std::size_t v, bool has_above, bool has_below) {
    float sum = diagonal_[v] * x[v];
    if (v > 0) sum -= c_x_[v - 1] * x[v - 1];
    if (v + 1 < Size()) sum -= c_x_[v] * x[v + 1];
    if (has_above) sum -= c_y_[v - width_] * x[v - width_];
    if (has_below) sum -= c_y_[v] * x[v + width_];
    return sum;
  };
  const auto row = static_cast<std::size_t>(width_);
  const std::size_t last_row = Size() - row;
  for (std::size_t v = 0; v < row; ++v) (*y)[v] = at(v, false, height_ > 1);
  for (std::size_t v = std::max(row, last_row); v < Size(); ++v) (*y)[v] = at(v, true, false);
  const float* d = diagonal_.data();
  const float* from = x.data();
  const float* across = c_x_.data();
  const float* down = c_y_.data();
  float* to = y->data();
  for (std::size_t v = row; v < last_row; ++v) {
    to[v] = d[v] * from[v] - across[v - 1] * from[v - 1] - across[v] * from[v + 1] -
            down[v - row] * from[v - row] - down[v] * from[v + row];
  }
}

/// Eight sums side by side, as long as eight can be added.
double Dot(const std::vector<float>& a, const std::vector<float>& b) {
  constexpr std::size_t kLanes = 8;
  double sums[kLanes] = {};
  std::size_t i = 0;
  for (; i + kLanes <= a.size(); i += kLanes) {
    for (std::size_t k = 0; k < kLanes; ++k) {
      sums[k] += static_cast<double>(a[i + k]) * static_cast<double>(b[i + k]);
    }
  }
  for (; i < a.size(); ++i) sums[0] += static_cast<double>(a[i]) * static_cast<double>(b[i]);
  double sum = 0.0;
  for (const double of_lane : sums) sum += of_lane;
  return sum;
}

/// Conjugate gradients for the correction of z_, preconditioned by the diagonal.
void HeightSolver::Relax(double tolerance) {
  std::vector<float> residual(Size(), 0.0F);
  for (std::size_t v = 0; v < Size(); ++v) {
    if (covered_[v]) residual[v] = weight_[v] * (data_[v] - z_[v]);
  }
  VisitEdges([&](int v, int u, float step, float conductance, bool /*along_x*/) {
    const float pull = conductance * (z_[u] - z_[v] - step);
    residual[v] += pull;
    residual[u] -= pull;
  });
  std::vector<float> inverse(Size(), 0.0F);
  for (std::size_t v = 0; v < Size(); ++v) {
    if (covered_[v] && diagonal_[v] > 0.0F) inverse[v] = 1.0F / diagonal_[v];
  }
  std::vector<float> scaled(Size());
  const auto scale = [&] {
    for (std::size_t v = 0; v < Size(); ++v) scaled[v] = inverse[v] * residual[v];
  };
  scale();
  std::vector<float> direction = scaled;
  std::vector<float> product(Size());
  double energy = Dot(residual, scaled);
  const double goal = tolerance * tolerance * energy;
  for (int i = 0; i < kMaxIterations && energy > goal; ++i) {
    Multiply(direction, &product);
    const double curvature = Dot(direction, product);
    if (!(curvature > 0.0)) break;
    const auto step = static_cast<float>(energy / curvature);
    for (std::size_t v = 0; v < Size(); ++v) {
      z_[v] += step * direction[v];
      residual[v] -= step * product[v];
    }
    scale();
    const double next = Dot(residual, scaled);
    const auto keep = static_cast<float>(next / energy);
    for (std::size_t v = 0; v < Size(); ++v) direction[v] = scaled[v] + keep * direction[v];
    energy = next;
  }
}

void HeightSolver::Solve() {
  for (int i = 0; i < kSolves; ++i) {
    SetConductances(i == 0 ? kRoughStep_m : kStep_m);
    Relax(i + 1 < kSolves ? kRoughTolerance : kTolerance);
  }
}

std::vector<float> HeightSolver::Heights() const {
  std::vector<float> heights = z_;
  for (std::size_t v = 0; v < Size(); ++v) {
    if (!covered_[v]) heights[v] = std::numeric_limits<float>::quiet_NaN();
  }
  return heights;
}

}  // namespace

HeightField SolveHeightField(const std::vector<GroundSample>& samples,
                             const Eigen::Vector2f& origin_m, float cell_m, int width, int height,
                             const HeightFieldOptions& options) {
  HeightSolver solver(width, height, cell_m);
  solver.AddSamples(samples, origin_m, options);
  solver.Solve();
  HeightField field;
  field.origin_m = origin_m;
  field.cell_m = cell_m;
  field.width = width;
  field.height = height;
  field.z_m = solver.Heights();
  return field;
}

}  // namespace scenecalib
