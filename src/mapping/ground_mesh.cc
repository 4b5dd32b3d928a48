#include "ground_mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "ground_samples.h"
#include "height_correction.h"
#include "poisson.h"

namespace scenecalib {
namespace {

/// Fewer samples than this in a tile make no surface.
constexpr std::size_t kMinTileSamples = 50;
/// Poisson's surface has to stay this near to the samples around it; elsewhere it closes itself
/// around the data.
constexpr float kMaxHeightError_m = 0.1F;

/// Neighbouring tiles agree to a millimetre or two; they overlap by this much, so that no grazing
/// ray slips through the step between them.
constexpr float kSeamOverlap_m = 0.1F;

/// Where a tile has data: a raster of the samples' heights, closed over small holes only, so that
/// the mesh neither covers what nobody saw nor grows over the data's border.
class DataMask {
 public:
  DataMask(const std::vector<GroundSample>& samples, double pixel_m, double max_hole_m)
      : inverse_pixel_(static_cast<float>(1.0 / pixel_m)),
        reach_(std::max(1, static_cast<int>(std::ceil(0.5 * max_hole_m / pixel_m)))) {
    Eigen::AlignedBox2f box;
    for (const GroundSample& sample : samples) box.extend(sample.position_m.head<2>());
    min_m_ = box.min();
    width_ = static_cast<int>(box.sizes().x() * inverse_pixel_) + 1 + 2 * reach_ + 2;
    height_ = static_cast<int>(box.sizes().y() * inverse_pixel_) + 1 + 2 * reach_ + 2;
    pixels_.assign(static_cast<std::size_t>(width_) * height_, Pixel());
    for (const GroundSample& sample : samples) {
      Pixel& pixel = pixels_[IndexOf(sample.position_m)];
      pixel.Extend(sample.position_m.z(), sample.position_m.z());
    }
    Dilate();
    Erode();
  }

  bool Covers(const Eigen::Vector3f& point_m) const {
    const Eigen::Vector2f offset = point_m.head<2>() - min_m_;
    const int x = static_cast<int>(std::floor(offset.x() * inverse_pixel_)) + reach_ + 1;
    const int y = static_cast<int>(std::floor(offset.y() * inverse_pixel_)) + reach_ + 1;
    if (x < 0 || y < 0 || x >= width_ || y >= height_) return false;
    const Pixel& pixel = pixels_[y * width_ + x];
    return pixel.covered && point_m.z() > pixel.low_m - kMaxHeightError_m &&
           point_m.z() < pixel.high_m + kMaxHeightError_m;
  }

 private:
  struct Pixel {
    float low_m = std::numeric_limits<float>::max();
    float high_m = std::numeric_limits<float>::lowest();
    bool covered = false;
    bool has_height() const { return low_m <= high_m; }
    void Extend(float low, float high) {
      low_m = std::min(low_m, low);
      high_m = std::max(high_m, high);
    }
  };

  int IndexOf(const Eigen::Vector3f& point_m) const {
    const Eigen::Vector2f offset = point_m.head<2>() - min_m_;
    const int x = static_cast<int>(offset.x() * inverse_pixel_) + reach_ + 1;
    const int y = static_cast<int>(offset.y() * inverse_pixel_) + reach_ + 1;
    return y * width_ + x;
  }

  /// One direction of a box dilation: every pixel takes in those `reach_` away along the stride.
  void DilateAlong(bool along_x) {
    const std::vector<Pixel> before = pixels_;
    for (int y = 0; y < height_; ++y) {
      for (int x = 0; x < width_; ++x) {
        Pixel& pixel = pixels_[y * width_ + x];
        for (int k = -reach_; k <= reach_; ++k) {
          const int nx = along_x ? x + k : x;
          const int ny = along_x ? y : y + k;
          if (nx < 0 || ny < 0 || nx >= width_ || ny >= height_) continue;
          const Pixel& other = before[ny * width_ + nx];
          if (other.has_height()) pixel.Extend(other.low_m, other.high_m);
        }
      }
    }
  }

  void Dilate() {
    DilateAlong(true);
    DilateAlong(false);
  }

  void Erode() {
    std::vector<char> row(pixels_.size(), 0);
    for (int y = 0; y < height_; ++y) {
      for (int x = reach_; x < width_ - reach_; ++x) {
        bool all = true;
        for (int k = -reach_; k <= reach_; ++k) all &= pixels_[y * width_ + x + k].has_height();
        row[y * width_ + x] = all ? 1 : 0;
      }
    }
    for (int y = reach_; y < height_ - reach_; ++y) {
      for (int x = 0; x < width_; ++x) {
        bool all = true;
        for (int k = -reach_; k <= reach_; ++k) all &= row[(y + k) * width_ + x] != 0;
        pixels_[y * width_ + x].covered = all;
      }
    }
  }

  Eigen::Vector2f min_m_;
  float inverse_pixel_;
  int reach_;
  int width_ = 0;
  int height_ = 0;
  std::vector<Pixel> pixels_;
};

/// The part of a triangle inside a tile, as a polygon (Sutherland and Hodgman 1974).
std::vector<Eigen::Vector3f> ClipToTile(std::vector<Eigen::Vector3f> polygon,
                                        const Eigen::AlignedBox2f& tile) {
  for (int side = 0; side < 4 && !polygon.empty(); ++side) {
    const int axis = side / 2;
    const bool upper = side % 2 == 1;
    const float limit = upper ? tile.max()[axis] : tile.min()[axis];
    const auto inside = [&](const Eigen::Vector3f& p) {
      return upper ? p[axis] <= limit : p[axis] >= limit;
    };
    std::vector<Eigen::Vector3f> clipped;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Eigen::Vector3f& from = polygon[i];
      const Eigen::Vector3f& to = polygon[(i + 1) % polygon.size()];
      if (inside(from)) clipped.push_back(from);
      if (inside(from) == inside(to)) continue;
      Eigen::Vector3f crossing =
          from + (limit - from[axis]) / (to[axis] - from[axis]) * (to - from);
      crossing[axis] = limit;
      clipped.push_back(crossing);
    }
    polygon = std::move(clipped);
  }
  return polygon;
}

/// Appends the part of a tile's surface that has data and lies inside the tile.
class MeshJoiner {
 public:
  void Append(const TriangleMesh& surface, const DataMask& mask, const Eigen::AlignedBox2f& tile) {
    std::vector<int> joined_index(surface.vertices_m.size(), -1);
    for (const std::array<int, 3>& triangle : surface.triangles) {
      bool wholly_inside = true;
      bool covered = true;
      for (const int vertex : triangle) {
        const Eigen::Vector3f& position_m = surface.vertices_m[vertex];
        wholly_inside &= tile.contains(Eigen::Vector2f(position_m.head<2>()));
        covered = covered && mask.Covers(position_m);
      }
      if (!covered) continue;
      if (wholly_inside) {
        std::array<int, 3> joined;
        for (int k = 0; k < 3; ++k) {
          int& index = joined_index[triangle[k]];
          if (index < 0) index = AddVertex(surface.vertices_m[triangle[k]]);
          joined[k] = index;
        }
        AddTriangle(joined);
        continue;
      }
      const std::vector<Eigen::Vector3f> polygon =
          ClipToTile({surface.vertices_m[triangle[0]], surface.vertices_m[triangle[1]],
                      surface.vertices_m[triangle[2]]},
                     tile);
      if (polygon.size() < 3) continue;
      const int first = AddVertex(polygon[0]);
      for (std::size_t k = 1; k < polygon.size(); ++k) AddVertex(polygon[k]);
      for (int k = 1; k + 1 < static_cast<int>(polygon.size()); ++k) {
        AddTriangle({first, first + k, first + k + 1});
      }
    }
  }

  TriangleMesh mesh;

 private:
  int AddVertex(const Eigen::Vector3f& position_m) {
    mesh.vertices_m.push_back(position_m);
    return static_cast<int>(mesh.vertices_m.size()) - 1;
  }

  /// Counter-clockwise seen from above.
  void AddTriangle(std::array<int, 3> triangle) {
    const Eigen::Vector3f& a = mesh.vertices_m[triangle[0]];
    const Eigen::Vector3f& b = mesh.vertices_m[triangle[1]];
    const Eigen::Vector3f& c = mesh.vertices_m[triangle[2]];
    if ((b - a).cross(c - a).z() < 0.0F) std::swap(triangle[1], triangle[2]);
    mesh.triangles.push_back(triangle);
  }
};

struct Tile {
  std::vector<GroundSample> samples;  // with overlap
  bool has_core = false;
};

/// Distributes the samples over the tiles that see them.
std::map<std::pair<int, int>, Tile> Divide(const std::vector<GroundSample>& samples,
                                           const GroundOptions& options) {
  std::map<std::pair<int, int>, Tile> tiles;
  const double size_m = options.tile_size_m;
  const double overlap_m = std::min(options.tile_overlap_m, 0.5 * size_m);
  const auto tile_of = [&](double coordinate) {
    return static_cast<int>(std::floor(coordinate / size_m));
  };
  for (const GroundSample& sample : samples) {
    const double x = sample.position_m.x();
    const double y = sample.position_m.y();
    for (int tx = tile_of(x - overlap_m); tx <= tile_of(x + overlap_m); ++tx) {
      for (int ty = tile_of(y - overlap_m); ty <= tile_of(y + overlap_m); ++ty) {
        Tile& tile = tiles[{tx, ty}];
        tile.samples.push_back(sample);
        tile.has_core |= tx == tile_of(x) && ty == tile_of(y);
      }
    }
  }
  return tiles;
}

}  // namespace

TriangleMesh BuildGroundMesh(const std::vector<ScenePoint>& points,
                             const std::vector<PointLabel>& labels, const GroundOptions& options) {
  const std::vector<GroundSample> samples = AverageGround(points, labels, options.column_size_m);
  MeshJoiner joiner;
  for (const auto& [index, tile] : Divide(samples, options)) {
    if (!tile.has_core || tile.samples.size() < kMinTileSamples) continue;
    const auto size_m = static_cast<float>(options.tile_size_m);
    const Eigen::Vector2f corner_m =
        size_m * Eigen::Vector2f(static_cast<float>(index.first), static_cast<float>(index.second));
    const Eigen::AlignedBox2f core(corner_m - Eigen::Vector2f::Constant(kSeamOverlap_m),
                                   corner_m + Eigen::Vector2f::Constant(size_m + kSeamOverlap_m));
    TriangleMesh surface = PoissonSurface(tile.samples, options.mesh_cell_m, options.point_weight);
    CorrectHeights(tile.samples, &surface);
    joiner.Append(surface, DataMask(tile.samples, options.column_size_m, options.max_hole_m), core);
  }
  return std::move(joiner.mesh);
}

}  // namespace scenecalib
