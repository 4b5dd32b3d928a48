#include "height_mesh.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>

namespace scenecalib {
namespace {

constexpr float kSplit = std::numeric_limits<float>::infinity();

struct LatticePoint {
  int x = 0;
  int y = 0;
};

LatticePoint Middle(const LatticePoint& a, const LatticePoint& b) {
  return {(a.x + b.x) / 2, (a.y + b.y) / 2};
}

/// A right triangle of the hierarchy: the hypotenuse runs from a to b, the right angle is at c.
struct RightTriangle {
  LatticePoint a, b, c;

  int leg() const { return std::abs(a.x - c.x) + std::abs(a.y - c.y); }
  LatticePoint middle() const { return Middle(a, b); }
  RightTriangle left() const { return {c, a, middle()}; }
  RightTriangle right() const { return {b, c, middle()}; }
  /// Smallest of all: its hypotenuse has no vertex between.
  bool is_leaf() const { return std::abs(a.x - b.x) <= 1 && std::abs(a.y - b.y) <= 1; }
};

class HeightMesher {
 public:
  HeightMesher(const HeightField& field, int first, int num_cells, int max_leg_cells,
               float max_error_m)
      : field_(field),
        first_(first),
        num_cells_(num_cells),
        max_leg_cells_(max_leg_cells),
        max_error_m_(max_error_m),
        error_m_(static_cast<std::size_t>(num_cells + 1) * (num_cells + 1), 0.0F) {}

  void Measure();
  void Append(TriangleMesh* mesh);

 private:
  float HeightAt(const LatticePoint& p) const { return field_.At(first_ + p.x, first_ + p.y); }
  std::size_t IndexOf(const LatticePoint& p) const {
    return static_cast<std::size_t>(p.y) * (num_cells_ + 1) + p.x;
  }
  std::array<RightTriangle, 2> Roots() const {
    const int n = num_cells_;
    return {{{{0, 0}, {n, n}, {n, 0}}, {{n, n}, {0, 0}, {0, n}}}};
  }
  RightTriangle Triangle(int id) const;
  float OwnError(const RightTriangle& triangle) const;
  void AppendTriangle(const RightTriangle& triangle, TriangleMesh* mesh);
  int VertexOf(const LatticePoint& p, TriangleMesh* mesh);

  const HeightField& field_;
  int first_;
  int num_cells_;
  int max_leg_cells_;
  float max_error_m_;
  std::vector<float> error_m_;  // by the middle of the hypotenuse, of the triangle and its parts
  std::vector<int> vertex_;
};

/// The path from a root to a triangle is written in the bits of its number, which begins with a 1.
RightTriangle HeightMesher::Triangle(int id) const {
  RightTriangle triangle = Roots()[id & 1];
  for (id >>= 1; id > 1; id >>= 1) triangle = (id & 1) ? triangle.left() : triangle.right();
  return triangle;
}

float HeightMesher::OwnError(const RightTriangle& triangle) const {
  const LatticePoint m = triangle.middle();
  const float at_a = HeightAt(triangle.a);
  const float at_b = HeightAt(triangle.b);
  const float at_m = HeightAt(m);
  const int num_missing = static_cast<int>(std::isnan(at_a)) + static_cast<int>(std::isnan(at_b)) +
                          static_cast<int>(std::isnan(at_m)) +
                          static_cast<int>(std::isnan(HeightAt(triangle.c)));
  if (num_missing == 4) return 0.0F;
  const bool on_side = m.x == 0 || m.y == 0 || m.x == num_cells_ || m.y == num_cells_;
  if (num_missing > 0 || on_side || triangle.leg() > max_leg_cells_) return kSplit;
  return std::abs(at_m - 0.5F * (at_a + at_b));
}

/// From the smallest triangles up: a triangle's error is also that of its parts and of its
/// neighbour across the hypotenuse, so that both are split or none.
void HeightMesher::Measure() {
  const int num_triangles = 2 * num_cells_ * num_cells_ - 2;
  for (int id = num_triangles + 1; id >= 2; --id) {
    const RightTriangle triangle = Triangle(id);
    if (triangle.is_leaf()) continue;
    float error_m = OwnError(triangle);
    for (const RightTriangle& part : {triangle.left(), triangle.right()}) {
      if (!part.is_leaf()) error_m = std::max(error_m, error_m_[IndexOf(part.middle())]);
    }
    float& entry = error_m_[IndexOf(triangle.middle())];
    entry = std::max(entry, error_m);
  }
}

int HeightMesher::VertexOf(const LatticePoint& p, TriangleMesh* mesh) {
  int& index = vertex_[IndexOf(p)];
  if (index < 0) {
    index = static_cast<int>(mesh->vertices_m.size());
    mesh->vertices_m.push_back(field_.Vertex(first_ + p.x, first_ + p.y));
  }
  return index;
}

void HeightMesher::AppendTriangle(const RightTriangle& triangle, TriangleMesh* mesh) {
  if (!triangle.is_leaf() && error_m_[IndexOf(triangle.middle())] > max_error_m_) {
    AppendTriangle(triangle.left(), mesh);
    AppendTriangle(triangle.right(), mesh);
    return;
  }
  if (std::isnan(HeightAt(triangle.a)) || std::isnan(HeightAt(triangle.b)) ||
      std::isnan(HeightAt(triangle.c))) {
    return;
  }
  mesh->triangles.push_back(
      {VertexOf(triangle.a, mesh), VertexOf(triangle.c, mesh), VertexOf(triangle.b, mesh)});
}

void HeightMesher::Append(TriangleMesh* mesh) {
  vertex_.assign(error_m_.size(), -1);
  for (const RightTriangle& root : Roots()) AppendTriangle(root, mesh);
}

}  // namespace

void AppendHeightMesh(const HeightField& field, int first, int num_cells, int max_leg_cells,
                      float max_error_m, TriangleMesh* mesh) {
  HeightMesher mesher(field, first, num_cells, max_leg_cells, max_error_m);
  mesher.Measure();
  mesher.Append(mesh);
}

}  // namespace scenecalib
