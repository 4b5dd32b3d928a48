#include "scenecalib/sensor/monotonic_inverse.h"

namespace scenecalib {
namespace {

double Evaluate(const std::vector<double>& coefficients, double x) {
  double value = 0.0;
  for (std::size_t i = coefficients.size(); i-- > 0;) value = value * x + coefficients[i];
  return value;
}

double Bisect(const std::vector<double>& coefficients, double low, double high) {
  const bool low_is_positive = Evaluate(coefficients, low) > 0.0;
  while (true) {
    const double middle = 0.5 * (low + high);
    if (!(middle > low && middle < high)) return low;
    ((Evaluate(coefficients, middle) > 0.0) == low_is_positive ? low : high) = middle;
  }
}

}  // namespace

std::vector<double> PositiveRoots(const std::vector<double>& coefficients, double x_max) {
  if (coefficients.size() < 2) return {};
  std::vector<double> derivative;
  for (std::size_t i = 1; i < coefficients.size(); ++i) {
    derivative.push_back(static_cast<double>(i) * coefficients[i]);
  }
  std::vector<double> borders = {0.0};
  for (const double root : PositiveRoots(derivative, x_max)) borders.push_back(root);
  borders.push_back(x_max);
  std::vector<double> roots;
  for (std::size_t i = 0; i + 1 < borders.size(); ++i) {
    const bool before = Evaluate(coefficients, borders[i]) > 0.0;
    const bool after = Evaluate(coefficients, borders[i + 1]) > 0.0;
    if (before != after) roots.push_back(Bisect(coefficients, borders[i], borders[i + 1]));
  }
  return roots;
}

}  // namespace scenecalib
