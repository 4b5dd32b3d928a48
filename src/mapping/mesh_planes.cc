#include "mesh_planes.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <unordered_map>
#include <utility>

namespace scenecalib {
namespace {

/// Triangles are gathered in square columns of this edge; all of a column share its fits.
constexpr double kColumnEdge_m = 0.2;
/// Longer triangles are cut up before they are gathered.
constexpr double kMaxPiece_m = 0.25;
/// Half-widths of the squares tried, in columns: 0.6 m, 1 m, 1.8 m and 3 m.
constexpr std::array<int, 4> kHalfWidths = {1, 2, 4, 7};
/// RMS of the mesh about a plane that still stands for the ground there, by square: up to twice the
/// mesh's own height error (3 mm) where many columns average it, well below a kerb or a pothole.
constexpr std::array<double, 4> kMaxRms_m = {0.004, 0.005, 0.006, 0.006};
/// Columns whose mean is farther off the plane found so far are another surface (the pavement
/// behind the kerb, the foot of a wall) and have no say in the next one.
constexpr double kMaxColumnOffset_m = 0.012;
/// A triangle farther from its column's plane is another surface.
constexpr double kMaxDistance_m = 0.015;
/// The plane's height is that of the square of this half-width, 1 m: on a cambered road the mean of
/// 3 m lies below the road everywhere, and all cameras of the vehicle with it.
constexpr int kHeightHalfWidth = 2;
/// A square has to be this full of columns on the plane, so that a fit does not lean over a hole or
/// an edge. The smallest one may lie along a kerb.
constexpr double kMinFill = 0.7;
constexpr double kMinSmallestFill = 0.6;

/// Moments of a height field, weighted by area.
struct HeightMoments {
  double weight = 0.0;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d sum_of_squares = Eigen::Matrix3d::Zero();

  void Add(const Eigen::Vector3d& point, double point_weight) {
    weight += point_weight;
    sum += point_weight * point;
    sum_of_squares += point_weight * point * point.transpose();
  }
  void Add(const HeightMoments& other) {
    weight += other.weight;
    sum += other.sum;
    sum_of_squares += other.sum_of_squares;
  }
};

struct Column {
  int x = 0;
  int y = 0;
  HeightMoments moments;
  MeshPlane plane;
};

std::uint64_t Key(int x, int y) {
  return (static_cast<std::uint64_t>(static_cast<std::uint32_t>(x)) << 32) |
         static_cast<std::uint32_t>(y);
}

/// Regression of height on x and y.
MeshPlane FitHeightPlane(const HeightMoments& moments) {
  const Eigen::Vector3d mean = moments.sum / moments.weight;
  const Eigen::Matrix3d covariance =
      moments.sum_of_squares / moments.weight - mean * mean.transpose();
  const Eigen::Vector2d slope =
      covariance.topLeftCorner<2, 2>().ldlt().solve(covariance.topRightCorner<2, 1>());
  const double variance = covariance(2, 2) - slope.dot(covariance.topRightCorner<2, 1>());
  MeshPlane plane;
  plane.point_m = mean;
  plane.normal = Eigen::Vector3d(-slope.x(), -slope.y(), 1.0).normalized();
  plane.thickness_m = std::sqrt(std::max(0.0, variance)) * plane.normal.z();
  return plane;
}

class ColumnGrid {
 public:
  explicit ColumnGrid(const Eigen::Vector3d& origin_m) : origin_m_(origin_m) {}

  int IndexOf(const Eigen::Vector3d& point) {
    const int x = static_cast<int>(std::floor((point.x() - origin_m_.x()) / kColumnEdge_m));
    const int y = static_cast<int>(std::floor((point.y() - origin_m_.y()) / kColumnEdge_m));
    const auto [entry, inserted] = index_.try_emplace(Key(x, y), static_cast<int>(columns_.size()));
    if (inserted) {
      columns_.emplace_back();
      columns_.back().x = x;
      columns_.back().y = y;
    }
    return entry->second;
  }

  /// Spreads a triangle over the columns that it covers; what is longer than a column is halved.
  void Add(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
    const double ab = (b - a).squaredNorm();
    const double bc = (c - b).squaredNorm();
    const double ca = (a - c).squaredNorm();
    if (std::max({ab, bc, ca}) > kMaxPiece_m * kMaxPiece_m) {
      if (ab >= bc && ab >= ca) return AddHalves(a, b, c);
      if (bc >= ca) return AddHalves(b, c, a);
      return AddHalves(c, a, b);
    }
    const double area = 0.5 * (b - a).cross(c - a).norm();
    HeightMoments& moments = columns_[IndexOf((a + b + c) / 3.0)].moments;
    for (const Eigen::Vector3d& vertex : {a, b, c}) moments.Add(vertex - origin_m_, area / 3.0);
  }

  /// Fits a plane around every column.
  void FitAll() {
    rows_.resize(columns_.size());
    for (std::size_t i = 0; i < rows_.size(); ++i) rows_[i] = static_cast<int>(i);
    std::sort(rows_.begin(), rows_.end(), [&](int a, int b) {
      return std::pair(columns_[a].y, columns_[a].x) < std::pair(columns_[b].y, columns_[b].x);
    });
    tbb::parallel_for(std::size_t{0}, columns_.size(), [&](std::size_t i) { Fit(&columns_[i]); });
  }
  const MeshPlane& plane(int index) const { return columns_[index].plane; }

 private:
  void AddHalves(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
    const Eigen::Vector3d middle = 0.5 * (a + b);
    Add(a, middle, c);
    Add(middle, b, c);
  }

  /// Calls visit(column) for the columns of a square in a fixed order.
  template <typename Visit>
  void VisitSquare(const Column& center, int half_width, const Visit& visit) const {
    for (int y = center.y - half_width; y <= center.y + half_width; ++y) {
      auto entry = std::lower_bound(rows_.begin(), rows_.end(), std::pair(y, center.x - half_width),
                                    [&](int i, const std::pair<int, int>& yx) {
                                      return std::pair(columns_[i].y, columns_[i].x) < yx;
                                    });
      for (; entry != rows_.end() && columns_[*entry].y == y &&
             columns_[*entry].x <= center.x + half_width;
           ++entry) {
        visit(columns_[*entry]);
      }
    }
  }

  /// The plane of those columns of a square that lie on the plane given; none when too few do.
  std::optional<MeshPlane> Refit(const Column& center, std::size_t size,
                                 const MeshPlane& before) const {
    const int half_width = kHalfWidths[size];
    HeightMoments moments;
    int num_columns = 0;
    VisitSquare(center, half_width, [&](const Column& column) {
      if (column.moments.weight <= 0.0) return;
      const Eigen::Vector3d mean = column.moments.sum / column.moments.weight;
      if (std::abs(before.normal.dot(mean - before.point_m)) > kMaxColumnOffset_m) return;
      moments.Add(column.moments);
      ++num_columns;
    });
    const int width = 2 * half_width + 1;
    const double min_fill = size == 0 ? kMinSmallestFill : kMinFill;
    if (num_columns < min_fill * width * width) return std::nullopt;
    MeshPlane plane = FitHeightPlane(moments);
    if (plane.thickness_m > kMaxRms_m[size]) return std::nullopt;
    plane.scale_m = width * kColumnEdge_m;
    plane.planar = true;
    return plane;
  }

  /// Height of the mesh next to the column over the plane, along its normal.
  double HeightOver(const MeshPlane& plane, const Column& center) const {
    HeightMoments moments;
    VisitSquare(center, kHeightHalfWidth, [&](const Column& column) {
      if (column.moments.weight <= 0.0) return;
      const Eigen::Vector3d mean = column.moments.sum / column.moments.weight;
      if (std::abs(plane.normal.dot(mean - plane.point_m)) > kMaxColumnOffset_m) return;
      moments.Add(column.moments);
    });
    if (moments.weight <= 0.0) return 0.0;
    return plane.normal.dot(moments.sum / moments.weight - plane.point_m);
  }

  /// A level plane through the column, or with the slope of what lies around it.
  std::vector<MeshPlane> Guesses(const Column& column) const {
    HeightMoments around;
    VisitSquare(column, kHalfWidths.front(),
                [&](const Column& other) { around.Add(other.moments); });
    MeshPlane guess = FitHeightPlane(around);
    std::vector<MeshPlane> guesses;
    if (guess.thickness_m <= kMaxRms_m.back()) guesses.push_back(guess);
    guess.point_m = column.moments.sum / column.moments.weight;
    guess.normal = Eigen::Vector3d::UnitZ();
    guesses.push_back(guess);
    return guesses;
  }

  /// From the smallest square up: each says which columns of the next lie on the same plane.
  void Fit(Column* column) const {
    if (column->moments.weight <= 0.0) return;
    for (const MeshPlane& guess : Guesses(*column)) {
      MeshPlane plane = guess;
      for (std::size_t size = 0; size < kHalfWidths.size(); ++size) {
        const auto wider = Refit(*column, size, plane);
        if (wider) plane = *wider;
      }
      if (!plane.planar) continue;
      plane.point_m += origin_m_ + HeightOver(plane, *column) * plane.normal;
      column->plane = plane;
      return;
    }
  }

  Eigen::Vector3d origin_m_;
  std::unordered_map<std::uint64_t, int> index_;  // looked up, never iterated
  std::vector<Column> columns_;
  std::vector<int> rows_;  // of columns, by y and x
};

}  // namespace

std::vector<MeshPlane> FitMeshPlanes(const TriangleMesh& mesh) {
  std::vector<MeshPlane> planes(mesh.triangles.size());
  if (mesh.triangles.empty()) return planes;
  // Moments about a nearby origin keep their precision far from the map's origin.
  const Eigen::Vector3d origin_m = mesh.vertices_m[mesh.triangles[0][0]].cast<double>();
  ColumnGrid grid(origin_m);
  std::vector<int> column_of_triangle(mesh.triangles.size());
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
    const Eigen::Vector3d a = mesh.vertices_m[mesh.triangles[i][0]].cast<double>();
    const Eigen::Vector3d b = mesh.vertices_m[mesh.triangles[i][1]].cast<double>();
    const Eigen::Vector3d c = mesh.vertices_m[mesh.triangles[i][2]].cast<double>();
    const Eigen::Vector3d centroid = (a + b + c) / 3.0;
    const Eigen::Vector3d normal_times_area = 0.5 * (b - a).cross(c - a);
    const double area = normal_times_area.norm();
    column_of_triangle[i] = grid.IndexOf(centroid);
    grid.Add(a, b, c);

    planes[i].point_m = centroid;
    if (area > 0.0) planes[i].normal = normal_times_area / area;
    planes[i].scale_m = std::sqrt(area);
  }
  grid.FitAll();
  for (std::size_t i = 0; i < planes.size(); ++i) {
    const MeshPlane& fit = grid.plane(column_of_triangle[i]);
    if (!fit.planar) continue;
    const double distance_m = fit.normal.dot(planes[i].point_m - fit.point_m);
    if (std::abs(distance_m) <= kMaxDistance_m) planes[i] = fit;
  }
  return planes;
}

}  // namespace scenecalib
