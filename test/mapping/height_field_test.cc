#include "../../src/mapping/height_field.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "../../src/mapping/height_mesh.h"
#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr float kCell_m = 0.0625F;
constexpr int kCells = 64;
constexpr float kSide_m = kCells * kCell_m;
/// Samples and lattice reach this much beyond the square, as those of a tile do.
constexpr int kPad = 8;
constexpr float kPad_m = kPad * kCell_m;
constexpr float kKerb_m = 0.12F;
constexpr float kKerbX_m = 2.03F;

/// Samples every 10 cm over a square of 4 m, of heights with noise; a kerb along x on demand.
struct Ground {
  float slope = 0.03F;
  float noise_m = 0.004F;
  float kerb_m = 0.0F;

  float HeightAt(float x, float y) const {
    return slope * x + 0.01F * std::sin(2.0F * y) + (x > kKerbX_m ? kerb_m : 0.0F);
  }
  std::vector<GroundSample> Samples() const {
    Random random(7);
    std::vector<GroundSample> samples;
    for (float x = -kPad_m; x <= kSide_m + kPad_m; x += 0.1F) {
      for (float y = -kPad_m; y <= kSide_m + kPad_m; y += 0.1F) {
        GroundSample sample;
        sample.position_m = {x, y,
                             HeightAt(x, y) + noise_m * static_cast<float>(random.Gaussian())};
        sample.normal = Eigen::Vector3f(-slope, -0.02F * std::cos(2.0F * y), 1.0F).normalized();
        sample.num_returns = 8;
        sample.has_normal = true;
        samples.push_back(sample);
      }
    }
    return samples;
  }
};

HeightField Solve(const std::vector<GroundSample>& samples) {
  const int width = kCells + 1 + 2 * kPad;
  return SolveHeightField(samples, Eigen::Vector2f::Constant(-kPad_m), kCell_m, width, width,
                          HeightFieldOptions());
}

/// The height at vertex (x, y) of the square.
float HeightOf(const HeightField& field, int x, int y) { return field.At(x + kPad, y + kPad); }

/// RMS error of the heights nearer to the kerb than far_m and farther than near_m.
double RmsBesideKerb(const HeightField& field, const Ground& ground, float near_m, float far_m) {
  double squares = 0.0;
  int count = 0;
  for (int y = 0; y < field.height; ++y) {
    for (int x = 0; x < field.width; ++x) {
      const Eigen::Vector3f vertex = field.Vertex(x, y);
      const float distance_m = std::abs(vertex.x() - kKerbX_m);
      if (std::isnan(vertex.z()) || distance_m < near_m || distance_m > far_m) continue;
      const double error = vertex.z() - ground.HeightAt(vertex.x(), vertex.y());
      squares += error * error;
      ++count;
    }
  }
  return std::sqrt(squares / std::max(1, count));
}

TEST(SolveHeightField, AveragesNoiseWithoutBendingTheGround) {
  const Ground ground;
  const HeightField field = Solve(ground.Samples());
  // 3 dozen samples lie within the smoothing length: a sixth of their noise is left.
  EXPECT_LT(RmsBesideKerb(field, ground, 0.0F, 10.0F), 0.35 * ground.noise_m);
}

TEST(SolveHeightField, KeepsAKerbSharp) {
  Ground ground;
  ground.kerb_m = kKerb_m;
  const HeightField field = Solve(ground.Samples());
  EXPECT_LT(RmsBesideKerb(field, ground, 0.1F, 0.5F), 0.003) << "the pavement leans to its kerb";
  // With samples every 10 cm nobody knows where between two of them the step is.
  EXPECT_LT(RmsBesideKerb(field, ground, 0.0F, 0.15F), 0.035);
}

TEST(SolveHeightField, LeavesHolesAndDoesNotGrowOverTheBorder) {
  std::vector<GroundSample> samples = Ground().Samples();
  const auto in_hole = [](const GroundSample& sample) {
    return (sample.position_m.head<2>() - Eigen::Vector2f(1.0F, 2.0F)).norm() < 0.5F;
  };
  samples.erase(std::remove_if(samples.begin(), samples.end(), in_hole), samples.end());
  samples.erase(std::remove_if(samples.begin(), samples.end(),
                               [](const GroundSample& s) { return s.position_m.x() > 3.0F; }),
                samples.end());
  const HeightField field = Solve(samples);
  EXPECT_TRUE(std::isnan(HeightOf(field, 16, 32))) << "the middle of the hole, 1 m across";
  EXPECT_FALSE(std::isnan(HeightOf(field, 32, 32)));
  EXPECT_TRUE(std::isnan(HeightOf(field, 51, 32))) << "0.2 m beyond the last samples";
}

TEST(SolveHeightField, BridgesWhatIsNarrowerThanAHole) {
  const Ground ground;
  std::vector<GroundSample> samples = ground.Samples();
  samples.erase(std::remove_if(samples.begin(), samples.end(),
                               [](const GroundSample& s) {
                                 return std::abs(s.position_m.x() - 2.0F) < 0.12F;
                               }),
                samples.end());
  const HeightField field = Solve(samples);
  for (int y = 16; y <= 48; ++y) {
    ASSERT_FALSE(std::isnan(HeightOf(field, 32, y)));
    EXPECT_NEAR(HeightOf(field, 32, y), ground.HeightAt(2.0F, kCell_m * static_cast<float>(y)),
                0.006F);
  }
}

TEST(SolveHeightField, HasNoHeightWithoutSamples) {
  for (const float z : Solve({}).z_m) EXPECT_TRUE(std::isnan(z));
}

TEST(AppendHeightMesh, IsWatertightAndKeepsWithinItsErrorOfTheHeights) {
  Ground ground;
  ground.kerb_m = kKerb_m;
  const HeightField field = Solve(ground.Samples());
  TriangleMesh mesh;
  AppendHeightMesh(field, kPad, kCells, 8, 0.001F, &mesh);
  EXPECT_LT(mesh.triangles.size(), 2u * kCells * kCells / 2) << "flat ground takes few triangles";
  double area_m2 = 0.0;
  double worst_m = 0.0;
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3f a = mesh.vertices_m[t[0]];
    const Eigen::Vector3f u = mesh.vertices_m[t[1]] - a;
    const Eigen::Vector3f v = mesh.vertices_m[t[2]] - a;
    const float twice_area = u.x() * v.y() - u.y() * v.x();
    ASSERT_GT(twice_area, 0.0F) << "counter-clockwise seen from above";
    area_m2 += 0.5 * twice_area;
    for (int y = 0; y <= kCells; ++y) {
      for (int x = 0; x <= kCells; ++x) {
        const Eigen::Vector3f p = field.Vertex(x + kPad, y + kPad) - a;
        const float s = (p.x() * v.y() - p.y() * v.x()) / twice_area;
        const float r = (u.x() * p.y() - u.y() * p.x()) / twice_area;
        if (s < 0.0F || r < 0.0F || s + r > 1.0F) continue;
        worst_m = std::max<double>(worst_m, std::abs(p.z() - s * u.z() - r * v.z()));
      }
    }
  }
  // The same area as the square: neither gap nor overlap (all triangles look up).
  EXPECT_NEAR(area_m2, kSide_m * kSide_m, 1e-3);
  // A vertex may be off by what its own triangle and the ones above it in the hierarchy allow.
  EXPECT_LT(worst_m, 0.004);
}

TEST(AppendHeightMesh, HasNoTriangleWhereAHeightIsMissing) {
  HeightField field = Solve(Ground().Samples());
  field.z_m[field.IndexOf(20 + kPad, 20 + kPad)] = std::numeric_limits<float>::quiet_NaN();
  TriangleMesh mesh;
  AppendHeightMesh(field, kPad, kCells, 8, 0.001F, &mesh);
  double area_m2 = 0.0;
  for (const auto& t : mesh.triangles) {
    const Eigen::Vector3f u = mesh.vertices_m[t[1]] - mesh.vertices_m[t[0]];
    const Eigen::Vector3f v = mesh.vertices_m[t[2]] - mesh.vertices_m[t[0]];
    area_m2 += 0.5 * (u.x() * v.y() - u.y() * v.x());
  }
  // Four to eight of the smallest triangles meet in a vertex.
  const double lost_m2 = kSide_m * kSide_m - area_m2;
  EXPECT_GT(lost_m2, 1.5 * kCell_m * kCell_m);
  EXPECT_LT(lost_m2, 4.5 * kCell_m * kCell_m);
}

}  // namespace
}  // namespace scenecalib
