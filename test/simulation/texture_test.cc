#include "scenecalib/simulation/texture.h"

#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <vector>

#include "scenecalib/simulation/noise.h"

namespace scenecalib {
namespace {

const Material kAllMaterials[] = {
    Material::kAsphalt, Material::kPaving, Material::kCobbles,  Material::kStone,
    Material::kPlaster, Material::kBrick,  Material::kRoof,     Material::kWindow,
    Material::kDoor,    Material::kSign,   Material::kBark,     Material::kLeaves,
    Material::kGrass,   Material::kMetal,  Material::kCarPaint, Material::kDarkGlass};

TEST(FilteredPulses, IsTheMeanOfThePulsesUnderTheFootprint) {
  for (const float footprint : {0.01F, 0.3F, 1.7F}) {
    for (float x = -3.0F; x < 3.0F; x += 0.137F) {
      int covered = 0;
      const int samples = 4000;
      for (int i = 0; i < samples; ++i) {
        const float at = x + footprint * ((static_cast<float>(i) + 0.5F) / samples - 0.5F);
        const float in_period = at - std::floor(at / 0.7F) * 0.7F;
        covered += in_period < 0.2F ? 1 : 0;
      }
      EXPECT_NEAR(FilteredPulses(x, 0.7F, 0.2F, footprint), static_cast<float>(covered) / samples,
                  2e-3F);
    }
  }
}

TEST(FilteredBand, CoversHalfOfAPixelThatItsEdgeCuts) {
  EXPECT_NEAR(FilteredBand(1.0F, 1.0F, 2.0F, 0.1F), 0.5F, 1e-5F);
  EXPECT_NEAR(FilteredBand(1.5F, 1.0F, 2.0F, 0.1F), 1.0F, 1e-5F);
  EXPECT_NEAR(FilteredBand(0.9F, 1.0F, 2.0F, 0.1F), 0.0F, 1e-5F);
  EXPECT_NEAR(FilteredBand(1.5F, 1.0F, 2.0F, 10.0F), 0.1F, 1e-6F);
}

TEST(EvaluateTexture, StaysAReflectanceForEveryMaterial) {
  for (const Material material : kAllMaterials) {
    Surface surface;
    surface.material = material;
    surface.seed = 9;
    for (int i = 0; i < 2000; ++i) {
      const Eigen::Vector2f uv(20.0F * SignedHash(i, 0, 1), 20.0F * SignedHash(i, 1, 1));
      const float size = 0.001F * std::pow(10.0F, 2.0F * UnitHash(i, 2, 1));
      const Eigen::Vector3f albedo = EvaluateTexture(surface, uv, {size, size});
      ASSERT_TRUE(albedo.allFinite());
      EXPECT_GE(albedo.minCoeff(), 0.0F);
      EXPECT_LE(albedo.maxCoeff(), 2.5F);
    }
  }
}

TEST(EvaluateTexture, HasDetailAtEveryScaleAndNoneBelowTwoPixels) {
  Surface surface;
  surface.material = Material::kAsphalt;
  surface.seed = 3;
  for (const float pixel : {0.005F, 0.02F, 0.08F}) {
    // Differences between places eight pixels apart are detail; a step of a tenth of a pixel must
    // change little, or a moving camera would see the texture flicker.
    double coarse = 0.0;
    double fine = 0.0;
    const int samples = 3000;
    for (int i = 0; i < samples; ++i) {
      const Eigen::Vector2f uv(100.0F * UnitHash(i, 0, 2), 0.4F + 2.0F * UnitHash(i, 1, 2));
      const auto level = [&](float dx) {
        return EvaluateTexture(surface, uv + Eigen::Vector2f(dx, 0.0F), {pixel, pixel}).mean();
      };
      coarse += std::pow(level(8.0F * pixel) - level(0.0F), 2);
      fine += std::pow(level(0.1F * pixel) - level(0.0F), 2);
    }
    const double mean = 0.5;
    EXPECT_GT(std::sqrt(coarse / samples) / mean, 0.12) << pixel;
    EXPECT_LT(std::sqrt(fine / samples), 0.12 * std::sqrt(coarse / samples)) << pixel;
  }
}

TEST(EvaluateTexture, DoesNotRepeatAlongTheRoad) {
  Surface surface;
  surface.material = Material::kAsphalt;
  std::set<float> levels;
  for (int i = 0; i < 1000; ++i) {
    levels.insert(EvaluateTexture(surface, {static_cast<float>(i), 1.0F}, {0.01F, 0.01F}).x());
  }
  EXPECT_GT(levels.size(), 950U);
}

}  // namespace
}  // namespace scenecalib
