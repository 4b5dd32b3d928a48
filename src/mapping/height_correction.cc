#include "height_correction.h"

#include <cmath>
#include <cstdint>
#include <unordered_map>
#include <vector>

namespace scenecalib {
namespace {

/// Vertices and residuals are found in square columns of this edge.
constexpr float kColumn_m = 0.2F;
/// Residuals are averaged over (2 kReach + 1)^2 columns: 1 m, wide enough for tens of samples.
constexpr int kReach = 2;
constexpr int kMinResiduals = 5;
/// Steeper than about 18 degrees or farther off than this, a sample belongs to a step.
constexpr float kMinNormalZ = 0.95F;
constexpr float kMaxResidual_m = 0.03F;

std::uint64_t ColumnKey(int x, int y) {
  return (static_cast<std::uint64_t>(static_cast<std::uint32_t>(x)) << 32) |
         static_cast<std::uint32_t>(y);
}
int ColumnOf(float coordinate_m) { return static_cast<int>(std::floor(coordinate_m / kColumn_m)); }

struct Mean {
  double sum = 0.0;
  int count = 0;
};

/// Height of a sample over the vertices around it, along its own normal: so a slope between them
/// does not count.
Mean ResidualOf(const GroundSample& sample, const TriangleMesh& surface,
                const std::unordered_map<std::uint64_t, std::vector<int>>& vertices) {
  Mean residual;
  for (int dx = -1; dx <= 1; ++dx) {
    for (int dy = -1; dy <= 1; ++dy) {
      const auto found = vertices.find(
          ColumnKey(ColumnOf(sample.position_m.x()) + dx, ColumnOf(sample.position_m.y()) + dy));
      if (found == vertices.end()) continue;
      for (const int vertex : found->second) {
        const Eigen::Vector3f offset_m = sample.position_m - surface.vertices_m[vertex];
        if (offset_m.head<2>().squaredNorm() > kColumn_m * kColumn_m) continue;
        const float along_normal_m = sample.normal.dot(offset_m);
        if (std::abs(along_normal_m) > kMaxResidual_m) continue;
        residual.sum += along_normal_m;
        ++residual.count;
      }
    }
  }
  return residual;
}

}  // namespace

void CorrectHeights(const std::vector<GroundSample>& samples, TriangleMesh* surface) {
  std::unordered_map<std::uint64_t, std::vector<int>> vertices;  // looked up, never iterated
  for (std::size_t i = 0; i < surface->vertices_m.size(); ++i) {
    const Eigen::Vector3f& vertex_m = surface->vertices_m[i];
    vertices[ColumnKey(ColumnOf(vertex_m.x()), ColumnOf(vertex_m.y()))].push_back(
        static_cast<int>(i));
  }
  std::unordered_map<std::uint64_t, Mean> residuals;  // likewise
  for (const GroundSample& sample : samples) {
    if (sample.normal.z() < kMinNormalZ) continue;
    const Mean residual = ResidualOf(sample, *surface, vertices);
    if (residual.count == 0) continue;
    Mean& mean =
        residuals[ColumnKey(ColumnOf(sample.position_m.x()), ColumnOf(sample.position_m.y()))];
    mean.sum += residual.sum / residual.count;
    ++mean.count;
  }
  for (Eigen::Vector3f& vertex_m : surface->vertices_m) {
    Mean around;
    for (int dx = -kReach; dx <= kReach; ++dx) {
      for (int dy = -kReach; dy <= kReach; ++dy) {
        const auto found =
            residuals.find(ColumnKey(ColumnOf(vertex_m.x()) + dx, ColumnOf(vertex_m.y()) + dy));
        if (found == residuals.end()) continue;
        around.sum += found->second.sum;
        around.count += found->second.count;
      }
    }
    if (around.count < kMinResiduals) continue;
    vertex_m.z() += static_cast<float>(around.sum / around.count);
  }
}

}  // namespace scenecalib
