#pragma once

#include <cstdint>

namespace scenecalib {

/// Integer hash of a lattice point: the source of every texture and of the road's unevenness, so
/// nothing repeats and nothing is stored.
inline std::uint32_t HashLattice(std::int32_t x, std::int32_t y, std::uint32_t seed) {
  std::uint32_t h = static_cast<std::uint32_t>(x) * 0x9e3779b1U +
                    static_cast<std::uint32_t>(y) * 0x85ebca77U + seed * 0xc2b2ae3dU;
  h ^= h >> 15;
  h *= 0x2c1b3c6dU;
  h ^= h >> 12;
  h *= 0x297a2d39U;
  h ^= h >> 15;
  return h;
}

/// The hash as a number in [-1, 1).
inline float SignedHash(std::int32_t x, std::int32_t y, std::uint32_t seed) {
  return static_cast<float>(static_cast<std::int32_t>(HashLattice(x, y, seed))) * 0x1.0p-31F;
}

/// The hash as a number in [0, 1).
inline float UnitHash(std::int32_t x, std::int32_t y, std::uint32_t seed) {
  return static_cast<float>(HashLattice(x, y, seed) >> 8) * 0x1.0p-24F;
}

inline std::int32_t FloorToInt(float x) {
  const auto truncated = static_cast<std::int32_t>(x);
  return truncated - (x < static_cast<float>(truncated) ? 1 : 0);
}

/// Smooth value noise in [-1, 1] on a unit lattice, once continuously differentiable. Its hash is
/// shorter than HashLattice: it is most of the cost of an image, and only its sum is seen.
inline float ValueNoise(float x, float y, std::uint32_t seed) {
  constexpr std::uint32_t kStepX = 0x9e3779b1U;
  constexpr std::uint32_t kStepY = 0x85ebca77U;
  const std::int32_t ix = FloorToInt(x);
  const std::int32_t iy = FloorToInt(y);
  float fx = x - static_cast<float>(ix);
  float fy = y - static_cast<float>(iy);
  fx = fx * fx * (3.0F - 2.0F * fx);
  fy = fy * fy * (3.0F - 2.0F * fy);
  const std::uint32_t corner = static_cast<std::uint32_t>(ix) * kStepX +
                               static_cast<std::uint32_t>(iy) * kStepY + seed * 0xc2b2ae3dU;
  const auto value = [](std::uint32_t h) {
    h ^= h >> 15;
    h *= 0x2c1b3c6dU;
    h ^= h >> 13;
    return static_cast<float>(static_cast<std::int32_t>(h));
  };
  const float v00 = value(corner);
  const float v10 = value(corner + kStepX);
  const float v01 = value(corner + kStepY);
  const float v11 = value(corner + kStepX + kStepY);
  const float low = v00 + fx * (v10 - v00);
  const float high = v01 + fx * (v11 - v01);
  return (low + fy * (high - low)) * 0x1.0p-31F;
}

}  // namespace scenecalib
