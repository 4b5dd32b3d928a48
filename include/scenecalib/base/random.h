#pragma once

#include <cmath>
#include <cstdint>

namespace scenecalib {

/// Small seeded generator (SplitMix64) whose numbers are the same with every standard library,
/// unlike std::normal_distribution. Not for cryptography.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}

  /// An independent generator for a sub-task, so that parallel tasks do not share a sequence.
  Random Fork(std::uint64_t stream) const {
    Random child(state_ ^ (0x9e3779b97f4a7c15ULL * (stream + 1)));
    child.NextBits();
    return child;
  }

  std::uint64_t NextBits() {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15ULL);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
  }

  /// Uniform in [0, 1).
  double Uniform() { return static_cast<double>(NextBits() >> 11) * 0x1.0p-53; }
  /// Uniform in [low, high).
  double Uniform(double low, double high) { return low + (high - low) * Uniform(); }
  /// Uniform integer in [0, n); n must be positive.
  std::uint64_t Index(std::uint64_t n) { return NextBits() % n; }

  /// Standard normal (Box-Muller).
  double Gaussian() {
    if (has_spare_) {
      has_spare_ = false;
      return spare_;
    }
    const double radius = std::sqrt(-2.0 * std::log(1.0 - Uniform()));
    const double angle = 6.283185307179586 * Uniform();
    spare_ = radius * std::sin(angle);
    has_spare_ = true;
    return radius * std::cos(angle);
  }

 private:
  std::uint64_t state_;
  double spare_ = 0.0;
  bool has_spare_ = false;
};

}  // namespace scenecalib
