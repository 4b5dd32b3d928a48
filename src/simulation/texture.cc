#include "scenecalib/simulation/texture.h"

#include <algorithm>
#include <cmath>

#include "scenecalib/simulation/noise.h"

namespace scenecalib {

namespace {

float Clamp01(float x) { return std::min(std::max(x, 0.0F), 1.0F); }

/// Visibility of a lattice of the given spacing: full from two pixels on, none below one (the
/// shortest wavelength of value noise is two spacings).
float Visibility(float spacing_m, float footprint_m) {
  return Clamp01(spacing_m / footprint_m - 1.0F);
}

/// 1 + x without ever turning negative or flat: 1 / (1 - x) below zero.
float Brightness(float x) { return x >= 0.0F ? 1.0F + x : 1.0F / (1.0F - x); }

/// What Detail adds up: octaves from the coarsest spacing down, each half the last.
struct DetailSpec {
  float coarsest_m;
  int octaves;
  float amplitude;  ///< of every octave: the same contrast at every distance
};

/// Multi-octave noise about 0. Each octave also comes stretched fourfold along u: streaks (wheel
/// tracks, rain marks) that survive the footprint of a grazing view.
float Detail(const Eigen::Vector2f& uv, const Eigen::Vector2f& footprint, std::uint32_t seed,
             const DetailSpec& spec) {
  float sum = 0.0F;
  float spacing = spec.coarsest_m;
  for (int i = 0; i < spec.octaves; ++i, spacing *= 0.5F) {
    const auto octave = seed + 2U * static_cast<std::uint32_t>(i);
    const float across = Visibility(spacing, footprint.y());
    if (across <= 0.0F) break;
    const float weight = i == 0   ? 0.4F
                         : i == 1 ? 0.7F
                                  : 1.0F;  // large blotches tell a tracker little
    const float along = Visibility(spacing, footprint.x());
    if (along > 0.0F) {
      // Turned, so that the lattice does not run along the surface's own lines.
      const float x = (0.8F * uv.x() + 0.6F * uv.y()) / spacing;
      const float y = (-0.6F * uv.x() + 0.8F * uv.y()) / spacing;
      const float turned = Visibility(spacing, std::max(footprint.x(), footprint.y()));
      sum += weight * turned * ValueNoise(x, y, octave);
    }
    const float stretched = Visibility(4.0F * spacing, footprint.x()) * (1.0F - 0.7F * along);
    if (stretched > 0.0F) {
      sum +=
          across * stretched * ValueNoise(uv.x() / (4.0F * spacing), uv.y() / spacing, octave + 1U);
    }
  }
  return spec.amplitude * sum;
}

/// Rectangular cells in rows that are shifted against each other, each with its own shade, between
/// joints: bricks, slabs, cobbles, tiles.
struct CellSpec {
  float length_m, height_m, joint_m;
  float shade;         ///< spread of the cells' brightness
  float joint_albedo;  ///< relative to the cells
};

float Cells(const Eigen::Vector2f& uv, const Eigen::Vector2f& footprint, std::uint32_t seed,
            const CellSpec& spec) {
  const std::int32_t row = FloorToInt(uv.y() / spec.height_m);
  const float shift = spec.length_m * UnitHash(row, 7, seed);
  const float x = uv.x() + shift;
  const std::int32_t column = FloorToInt(x / spec.length_m);
  const float visible = Visibility(0.4F * spec.length_m, footprint.x()) *
                        Visibility(0.6F * spec.height_m, footprint.y());
  const float shade = 1.0F + visible * spec.shade * SignedHash(column, row, seed + 1U);
  const float upright = FilteredPulses(x, spec.length_m, spec.joint_m, footprint.x());
  const float level = FilteredPulses(uv.y(), spec.height_m, spec.joint_m, footprint.y());
  // Where rows shift against each other the upright joints blur with the rows.
  const float joint = std::max(level, upright);
  return shade + joint * (spec.joint_albedo - shade);
}

/// Blots with soft edges, one at most per cell of the lattice: stains, patches, leaves on the road.
float Blots(const Eigen::Vector2f& uv, const Eigen::Vector2f& footprint, std::uint32_t seed,
            float cell_m, float share) {
  const float visible = Visibility(0.25F * cell_m, std::max(footprint.x(), footprint.y()));
  if (visible <= 0.0F) return 0.0F;
  const std::int32_t ix = FloorToInt(uv.x() / cell_m);
  const std::int32_t iy = FloorToInt(uv.y() / cell_m);
  if (UnitHash(ix, iy, seed) > share) return 0.0F;
  const float radius = (0.12F + 0.2F * UnitHash(ix, iy, seed + 1U)) * cell_m;
  const float margin = cell_m - 2.0F * radius;
  const float dx =
      uv.x() - static_cast<float>(ix) * cell_m - radius - margin * UnitHash(ix, iy, seed + 2U);
  const float dy =
      uv.y() - static_cast<float>(iy) * cell_m - radius - margin * UnitHash(ix, iy, seed + 3U);
  const float edge = std::max({footprint.x(), footprint.y(), 0.15F * radius});
  const float inside = Clamp01((radius - std::sqrt(dx * dx + dy * dy)) / edge + 0.5F);
  return visible * inside * SignedHash(ix, iy, seed + 4U);
}

/// Share of the pixel that road paint covers: edge lines, a dashed centre line, zebra crossings,
/// stop lines and single strokes.
float RoadMarking(const Eigen::Vector2f& uv, const Eigen::Vector2f& footprint, std::uint32_t seed) {
  const auto lane = static_cast<float>(RoadLayout::kLaneM);
  const float side = std::abs(uv.y());
  float paint = FilteredPulses(uv.x(), 6.0F, 3.0F, footprint.x()) *
                FilteredBand(uv.y(), -0.07F, 0.07F, footprint.y());
  paint = std::max(paint, FilteredBand(side, lane, lane + 0.12F, footprint.y()));
  // Bays for parked cars.
  paint = std::max(paint, FilteredPulses(uv.x(), 5.8F, 0.1F, footprint.x()) *
                              FilteredBand(side, lane, lane + 1.9F, footprint.y()));
  constexpr float kStretch = 23.0F;
  const std::int32_t stretch = FloorToInt(uv.x() / kStretch);
  const float x = uv.x() - kStretch * static_cast<float>(stretch);
  const float kind = UnitHash(stretch, 3, seed);
  if (kind < 0.45F) {  // zebra
    paint = std::max(paint, FilteredBand(x, 8.0F, 11.0F, footprint.x()) *
                                FilteredPulses(uv.y() + 10.0F, 1.0F, 0.5F, footprint.y()) *
                                FilteredBand(uv.y(), -lane, lane, footprint.y()));
  } else if (kind < 0.75F) {  // stop line and a stroke before it
    paint = std::max(paint, FilteredBand(x, 12.0F, 12.4F, footprint.x()) *
                                FilteredBand(uv.y(), -lane, -0.2F, footprint.y()));
    const float middle = -0.5F * lane;
    paint = std::max(paint, FilteredBand(x, 5.0F, 8.0F, footprint.x()) *
                                FilteredBand(uv.y(), middle - 0.1F, middle + 0.1F, footprint.y()));
  }
  return paint;
}

/// Strokes of random glyphs in a grid: readable by a tracker, if by nobody else.
float Glyphs(const Eigen::Vector2f& uv, const Eigen::Vector2f& footprint, const Surface& surface) {
  const float glyph = std::min(0.5F * surface.extent_m.y(), 0.35F);
  const float cell = glyph / 5.0F;
  const float visible = Visibility(cell, std::max(footprint.x(), footprint.y()));
  const float fx = uv.x() / cell;
  const float fy = uv.y() / cell;
  const std::int32_t ix = FloorToInt(fx);
  const std::int32_t iy = FloorToInt(fy);
  if (ix % 6 == 5 || iy % 7 >= 5) return 0.0F;
  const float on = UnitHash(ix, iy, surface.seed) < 0.5F ? 1.0F : 0.0F;
  return 0.5F * (1.0F - visible) * 0.7F + visible * on;
}

/// Share of the pixel that is frame: the border of the pane and its bars.
float Frame(const Eigen::Vector2f& uv, const Eigen::Vector2f& footprint, const Surface& surface,
            float border_m, float bars_across) {
  const Eigen::Vector2f& size = surface.extent_m;
  const float inside_x = FilteredBand(uv.x(), border_m, size.x() - border_m, footprint.x());
  const float inside_y = FilteredBand(uv.y(), border_m, size.y() - border_m, footprint.y());
  const float period = size.x() / bars_across;
  const float bar = FilteredPulses(uv.x() + 0.5F * border_m, period, border_m, footprint.x());
  const float cross =
      FilteredBand(uv.y(), 0.62F * size.y(), 0.62F * size.y() + border_m, footprint.y());
  return 1.0F - inside_x * inside_y * (1.0F - bar) * (1.0F - cross);
}

constexpr DetailSpec kAsphaltDetail{1.0F, 8, 0.32F};
constexpr DetailSpec kWallDetail{1.0F, 8, 0.26F};
constexpr DetailSpec kFineDetail{0.5F, 7, 0.28F};

Eigen::Vector3f Asphalt(const Surface& surface, const Eigen::Vector2f& uv,
                        const Eigen::Vector2f& footprint) {
  float brightness = Brightness(1.3F * Detail(uv, footprint, surface.seed, kAsphaltDetail));
  brightness *= 1.0F + 0.5F * Blots(uv, footprint, surface.seed + 50U, 1.9F, 0.5F) +
                0.7F * Blots(uv, footprint, surface.seed + 60U, 0.43F, 0.25F);
  Eigen::Vector3f albedo = brightness * surface.albedo;
  const float paint = RoadMarking(uv, footprint, surface.seed);
  if (paint > 0.0F) {
    const float wear =
        Clamp01(0.9F + 0.8F * Detail(uv, footprint, surface.seed + 80U, kFineDetail));
    albedo += paint * wear * (Eigen::Vector3f(0.62F, 0.64F, 0.65F) - albedo);
  }
  return albedo;
}

Eigen::Vector3f Window(const Surface& surface, const Eigen::Vector2f& uv,
                       const Eigen::Vector2f& footprint) {
  // Behind the glass: a curtain in folds, or a dark room with something in it.
  const bool curtain = (surface.seed & 3U) != 0U;
  const float room = 1.0F + 2.5F * Detail(uv, footprint, surface.seed, {0.6F, 6, 0.25F});
  const float glass = curtain ? 0.3F * (0.7F + 0.5F * room) : 0.08F * std::max(room, 0.1F);
  const float frame = Frame(uv, footprint, surface, 0.06F, 2.0F);
  const float worn = 1.0F + Detail(uv, footprint, surface.seed + 9U, kFineDetail);
  const Eigen::Vector3f behind = glass * Eigen::Vector3f(1.05F, 1.0F, 0.95F);
  return behind + frame * (worn * surface.albedo - behind);
}

Eigen::Vector3f Leaves(const Surface& surface, const Eigen::Vector2f& uv,
                       const Eigen::Vector2f& footprint) {
  // Leaves have their texture coordinates far apart, so the coarse cell is the leaf.
  const float leaf =
      SignedHash(FloorToInt(uv.x() / 16.0F), FloorToInt(uv.y() / 16.0F), surface.seed);
  const float vein = Detail(uv, footprint, surface.seed, kFineDetail);
  const Eigen::Vector3f tint(1.0F - 0.2F * leaf, 1.0F, 1.0F + 0.3F * leaf);
  return std::max(1.0F + 0.55F * leaf + vein, 0.1F) * surface.albedo.cwiseProduct(tint);
}

}  // namespace

float FilteredPulses(float x, float period, float width, float footprint) {
  // Integral of the pulse train from 0 to t, t in periods.
  const float share = width / period;
  const auto integral = [share](float t) {
    const auto whole = static_cast<float>(FloorToInt(t));
    return whole * share + std::min(t - whole, share);
  };
  const float half = 0.5F * std::max(footprint, 1e-4F) / period;
  const float t = x / period;
  // Float differences of large numbers: harmless, t stays below some thousands.
  return Clamp01((integral(t + half) - integral(t - half)) / (2.0F * half));
}

float FilteredBand(float x, float low, float high, float footprint) {
  const float half = 0.5F * std::max(footprint, 1e-4F);
  const float covered = std::min(x + half, high) - std::max(x - half, low);
  return Clamp01(covered / (2.0F * half));
}

Eigen::Vector3f EvaluateTexture(const Surface& surface, const Eigen::Vector2f& uv,
                                const Eigen::Vector2f& footprint) {
  const std::uint32_t seed = surface.seed;
  const auto with_detail = [&](const DetailSpec& spec, float factor) {
    const float brightness = factor * Brightness(1.3F * Detail(uv, footprint, seed, spec));
    return Eigen::Vector3f(brightness * surface.albedo);
  };
  const auto stains = [&](float cell_m) {
    return 1.0F + 0.5F * Blots(uv, footprint, seed + 50U, cell_m, 0.5F);
  };
  switch (surface.material) {
    case Material::kAsphalt:
      return Asphalt(surface, uv, footprint);
    case Material::kPaving:
      return with_detail(kWallDetail, stains(0.7F) * Cells(uv, footprint, seed,
                                                           {0.6F, 0.4F, 0.012F, 0.25F, 0.35F}));
    case Material::kCobbles:
      return with_detail(kFineDetail, stains(2.3F) * Cells(uv, footprint, seed,
                                                           {0.16F, 0.13F, 0.015F, 0.3F, 0.4F}));
    case Material::kBrick:
      return with_detail(kWallDetail,
                         Cells(uv, footprint, seed, {0.25F, 0.08F, 0.012F, 0.35F, 1.5F}));
    case Material::kRoof:
      return with_detail(kWallDetail, Cells(uv, footprint, seed, {0.3F, 0.35F, 0.03F, 0.3F, 0.4F}));
    case Material::kPlaster:
      return with_detail(kWallDetail, stains(1.3F));
    case Material::kStone:
      return with_detail(kFineDetail, stains(0.4F));
    case Material::kGrass:
      return with_detail({0.8F, 8, 0.32F}, 1.0F);
    case Material::kBark:
      return with_detail({0.25F, 7, 0.35F}, 1.0F);
    case Material::kMetal:
      return with_detail({0.3F, 6, 0.2F}, stains(0.2F));
    case Material::kDarkGlass:
      return with_detail({0.8F, 5, 0.3F}, 1.0F);
    case Material::kCarPaint: {
      const float gap = FilteredPulses(uv.x(), 1.1F, 0.012F, footprint.x());
      return with_detail({0.9F, 7, 0.09F}, 1.0F - 0.8F * gap);
    }
    case Material::kSheet: {
      const float rib = FilteredPulses(uv.x(), 0.3F, 0.12F, footprint.x());
      const float seam = FilteredPulses(uv.y(), 3.1F, 0.015F, footprint.y());
      return with_detail({1.2F, 8, 0.1F}, (1.0F - 0.25F * rib) * (1.0F - 0.5F * seam));
    }
    case Material::kFieldStone:
      return with_detail(kFineDetail,
                         Cells(uv, footprint, seed, {0.34F, 0.21F, 0.03F, 0.45F, 0.55F}));
    case Material::kLeaves:
      return Leaves(surface, uv, footprint);
    case Material::kWindow:
      return Window(surface, uv, footprint);
    case Material::kDoor:
      return with_detail(kFineDetail, 1.0F - 0.5F * Frame(uv, footprint, surface, 0.1F, 2.0F));
    case Material::kSign: {
      const Eigen::Vector3f plate = with_detail({0.3F, 6, 0.08F}, 1.0F);
      const Eigen::Vector3f ink = Eigen::Vector3f::Constant(plate.mean() > 0.3F ? 0.05F : 0.75F);
      return plate + Glyphs(uv, footprint, surface) * (ink - plate);
    }
  }
  return surface.albedo;
}

}  // namespace scenecalib
