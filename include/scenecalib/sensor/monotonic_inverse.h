#pragma once

#include <Eigen/Core>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <vector>

namespace scenecalib {

/// Approximate inverse of an increasing function through the origin, x ~ sum m_i y^i, i = 1..5 (the
/// m_i of Appendix B). Good to about 1e-3 over the fitted range: a start for InvertMonotonic.
class ApproximateInverse {
 public:
  ApproximateInverse() = default;

  /// Least squares over x in [0, x_max]. function(x, derivative*) -> y.
  template <typename Function>
  ApproximateInverse(const Function& function, double x_max) {
    constexpr int kNumSamples = 64;
    y_scale_ = 1.0 / function(x_max, nullptr);
    Eigen::Matrix<double, kNumSamples, 5> powers;
    Eigen::Matrix<double, kNumSamples, 1> x;
    for (int i = 0; i < kNumSamples; ++i) {
      x[i] = x_max * (i + 1) / kNumSamples;
      const double y = y_scale_ * function(x[i], nullptr);
      for (int power = 0; power < 5; ++power) powers(i, power) = std::pow(y, power + 1);
    }
    m_ = powers.colPivHouseholderQr().solve(x);
  }

  double operator()(double y) const {
    const double t = y_scale_ * y;
    return t * (m_[0] + t * (m_[1] + t * (m_[2] + t * (m_[3] + t * m_[4]))));
  }

 private:
  double y_scale_ = 1.0;
  Eigen::Matrix<double, 5, 1> m_ = Eigen::Matrix<double, 5, 1>::Zero();
};

/// x in [0, x_max] with function(x) = y, to machine precision: Newton from `guess`, falling back to
/// bisection where a step leaves the bracket. `y` must lie in [0, function(x_max)] and the function
/// must increase there.
template <typename Function>
double InvertMonotonic(const Function& function, double y, double x_max, double guess) {
  constexpr int kMaxIterations = 100;  // bisection alone would end at 53
  constexpr double kLastStep = 1e-9;   // relative; Newton squares it, so the next one is nothing
  double low = 0.0;
  double high = x_max;
  double x = std::min(std::max(guess, 0.0), x_max);
  for (int i = 0; i < kMaxIterations; ++i) {
    double slope = 0.0;
    const double error = function(x, &slope) - y;
    if (error == 0.0) return x;
    (error > 0.0 ? high : low) = x;
    double next = x - error / slope;
    if (!(next >= low && next <= high)) {
      next = 0.5 * (low + high);
      if (high - low <= 1e-15 * x_max) return next;
    } else if (std::abs(next - x) <= kLastStep * x_max) {
      return next;
    }
    x = next;
  }
  return x;
}

/// Where sum coefficients[i] x^i changes its sign in (0, x_max), in increasing order: between
/// neighbouring roots of its derivative a polynomial is monotonic, so bisection finds them all.
/// Each is returned from the side before the change.
std::vector<double> PositiveRoots(const std::vector<double>& coefficients, double x_max);

}  // namespace scenecalib
