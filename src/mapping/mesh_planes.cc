#include "mesh_planes.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <cstdint>
#include <unordered_map>

namespace scenecalib {
namespace {

/// Triangles are gathered in square columns of this edge; all of a column share its fits.
constexpr double kColumnEdge_m = 0.2;
/// Half-widths of the squares tried, in columns: 3 m, 1.8 m, 1 m and 0.6 m.
constexpr std::array<int, 4> kHalfWidths = {7, 4, 2, 1};
/// RMS of the mesh about a plane that still stands for the ground there: twice the mesh's own
/// height error (3 mm), well below a kerb or a pothole.
constexpr double kMaxRms_m = 0.006;
/// A triangle farther from its column's plane is another surface (the kerb's face, a step).
constexpr double kMaxDistance_m = 0.02;
/// A square has to be this full of columns, so that a fit does not lean over a hole or an edge.
constexpr double kMinFill = 0.7;

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

  Column& column(int index) { return columns_[index]; }

  void FitAll() {
    for (Column& column : columns_) Fit(&column);
  }

 private:
  void Fit(Column* column) const {
    for (const int half_width : kHalfWidths) {
      HeightMoments moments;
      int num_columns = 0;
      for (int dx = -half_width; dx <= half_width; ++dx) {
        for (int dy = -half_width; dy <= half_width; ++dy) {
          const auto found = index_.find(Key(column->x + dx, column->y + dy));
          if (found == index_.end()) continue;
          moments.Add(columns_[found->second].moments);
          ++num_columns;
        }
      }
      const int width = 2 * half_width + 1;
      if (num_columns < kMinFill * width * width) continue;
      MeshPlane plane = FitHeightPlane(moments);
      if (plane.thickness_m > kMaxRms_m) continue;
      plane.point_m += origin_m_;
      plane.scale_m = width * kColumnEdge_m;
      plane.planar = true;
      column->plane = plane;
      return;
    }
  }

  Eigen::Vector3d origin_m_;
  std::unordered_map<std::uint64_t, int> index_;  // looked up, never iterated
  std::vector<Column> columns_;
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
    HeightMoments& moments = grid.column(column_of_triangle[i]).moments;
    for (const Eigen::Vector3d& vertex : {a, b, c}) moments.Add(vertex - origin_m, area / 3.0);

    planes[i].point_m = centroid;
    if (area > 0.0) planes[i].normal = normal_times_area / area;
    planes[i].scale_m = std::sqrt(area);
  }
  grid.FitAll();
  for (std::size_t i = 0; i < planes.size(); ++i) {
    const MeshPlane& fit = grid.column(column_of_triangle[i]).plane;
    if (!fit.planar) continue;
    const double distance_m = fit.normal.dot(planes[i].point_m - fit.point_m);
    if (std::abs(distance_m) <= kMaxDistance_m) planes[i] = fit;
  }
  return planes;
}

}  // namespace scenecalib
