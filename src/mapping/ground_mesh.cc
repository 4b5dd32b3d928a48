#include "ground_mesh.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "ground_samples.h"
#include "height_field.h"
#include "height_mesh.h"

namespace scenecalib {
namespace {

/// Fewer samples than this in a tile make no surface.
constexpr std::size_t kMinTileSamples = 50;
/// The mesh leaves the heights by at most this, and no triangle is longer than this.
constexpr float kMaxMeshError_m = 0.001F;
constexpr double kMaxLeg_m = 0.5;

using TileIndex = std::pair<int, int>;

struct Tile {
  std::vector<GroundSample> samples;  // with overlap
  bool has_core = false;
};

/// The lattice that all tiles share: its vertices are the multiples of cell_m.
struct Lattice {
  Lattice(const GroundOptions& options) : cells_per_tile(1), size_m(options.tile_size_m) {
    while (size_m / cells_per_tile > 1.001 * options.mesh_cell_m) cells_per_tile *= 2;
    cell_m = size_m / cells_per_tile;
    pad = std::max(1, static_cast<int>(std::ceil(Overlap(options) / cell_m)));
    pad = std::min(pad, cells_per_tile);
  }
  static double Overlap(const GroundOptions& options) {
    return std::min(options.tile_overlap_m, options.tile_size_m);
  }
  int width() const { return cells_per_tile + 1 + 2 * pad; }

  int cells_per_tile;  // a power of two
  int pad = 1;         // cells around a tile that its solution also covers
  double size_m;
  double cell_m = 0.0;
};

/// Distributes the samples over the tiles that see them.
std::map<TileIndex, Tile> Divide(const std::vector<GroundSample>& samples, double size_m,
                                 double overlap_m) {
  std::map<TileIndex, Tile> tiles;
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

HeightField SolveTile(const TileIndex& index, const std::vector<GroundSample>& samples,
                      const Lattice& lattice, const GroundOptions& options) {
  HeightFieldOptions field_options;
  field_options.smoothing_m = options.smoothing_m;
  field_options.max_hole_m = options.max_hole_m;
  field_options.sample_area_m2 = options.column_size_m * options.column_size_m;
  const double pad_m = lattice.pad * lattice.cell_m;
  const Eigen::Vector2d corner_m(index.first * lattice.size_m - pad_m,
                                 index.second * lattice.size_m - pad_m);
  return SolveHeightField(samples, corner_m.cast<float>(), static_cast<float>(lattice.cell_m),
                          lattice.width(), lattice.width(), field_options);
}

/// Tiles side by side differ by fractions of a millimetre where they meet: there all take the mean.
class TileSeams {
 public:
  TileSeams(const std::map<TileIndex, int>& slots, const std::vector<HeightField>& fields,
            const Lattice& lattice)
      : slots_(slots), fields_(fields), lattice_(lattice) {}

  HeightField Joined(const TileIndex& index) const {
    HeightField field = fields_[slots_.at(index)];
    const int n = lattice_.cells_per_tile;
    for (int i = 0; i <= n; ++i) {
      for (const auto& [x, y] :
           {std::pair(i, 0), std::pair(i, n), std::pair(0, i), std::pair(n, i)}) {
        field.z_m[field.IndexOf(lattice_.pad + x, lattice_.pad + y)] = MeanAt(index, x, y);
      }
    }
    return field;
  }

 private:
  /// Over all tiles that hold the vertex on their sides, in a fixed order.
  float MeanAt(const TileIndex& index, int x, int y) const {
    const int n = lattice_.cells_per_tile;
    double sum = 0.0;
    int count = 0;
    for (int ty = -1; ty <= 1; ++ty) {
      for (int tx = -1; tx <= 1; ++tx) {
        const int local_x = x - tx * n;
        const int local_y = y - ty * n;
        if (local_x < 0 || local_y < 0 || local_x > n || local_y > n) continue;
        const auto slot = slots_.find({index.first + tx, index.second + ty});
        if (slot == slots_.end()) continue;
        const float z_m = fields_[slot->second].At(lattice_.pad + local_x, lattice_.pad + local_y);
        if (std::isnan(z_m)) continue;
        sum += z_m;
        ++count;
      }
    }
    if (count == 0) return std::numeric_limits<float>::quiet_NaN();
    return static_cast<float>(sum / count);
  }

  const std::map<TileIndex, int>& slots_;
  const std::vector<HeightField>& fields_;
  const Lattice& lattice_;
};

void Append(const TriangleMesh& part, TriangleMesh* mesh) {
  const int offset = static_cast<int>(mesh->vertices_m.size());
  mesh->vertices_m.insert(mesh->vertices_m.end(), part.vertices_m.begin(), part.vertices_m.end());
  for (const std::array<int, 3>& t : part.triangles) {
    mesh->triangles.push_back({t[0] + offset, t[1] + offset, t[2] + offset});
  }
}

}  // namespace

TriangleMesh BuildGroundMesh(const std::vector<LidarReturn>& points,
                             const std::vector<PointLabel>& labels, const GroundOptions& options) {
  const Lattice lattice(options);
  const std::map<TileIndex, Tile> tiles =
      Divide(AverageGround(points, labels, options.column_size_m), lattice.size_m,
             lattice.pad * lattice.cell_m);
  std::vector<TileIndex> indices;
  std::map<TileIndex, int> slots;
  for (const auto& [index, tile] : tiles) {
    if (!tile.has_core || tile.samples.size() < kMinTileSamples) continue;
    slots[index] = static_cast<int>(indices.size());
    indices.push_back(index);
  }
  std::vector<HeightField> fields(indices.size());
  tbb::parallel_for(std::size_t{0}, indices.size(), [&](std::size_t i) {
    fields[i] = SolveTile(indices[i], tiles.at(indices[i]).samples, lattice, options);
  });
  const TileSeams seams(slots, fields, lattice);
  const int max_leg_cells = std::max(1, static_cast<int>(kMaxLeg_m / lattice.cell_m));
  std::vector<TriangleMesh> meshes(indices.size());
  tbb::parallel_for(std::size_t{0}, indices.size(), [&](std::size_t i) {
    AppendHeightMesh(seams.Joined(indices[i]), lattice.pad, lattice.cells_per_tile, max_leg_cells,
                     kMaxMeshError_m, &meshes[i]);
  });
  TriangleMesh mesh;
  for (const TriangleMesh& part : meshes) Append(part, &mesh);
  return mesh;
}

}  // namespace scenecalib
