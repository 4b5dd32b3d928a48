#include "radial_field.h"

#include <algorithm>
#include <cmath>

#include "scenecalib/sensor/lens_shape.h"

namespace scenecalib {
namespace {

constexpr double kStep = 1e-4;
constexpr double kSpacing_px = 8.0;

}  // namespace

RadialField::RadialField(const CameraModel& model, const TunableIntrinsics& tunable)
    : columns_(static_cast<int>(std::ceil(model.width_px() / kSpacing_px)) + 1),
      rows_(static_cast<int>(std::ceil(model.height_px() / kSpacing_px)) + 1),
      nodes_(static_cast<std::size_t>(columns_ * rows_), Eigen::Vector2d::Zero()) {
  const auto less = WithRadialChange(model, -kStep);
  const auto more = WithRadialChange(model, kStep);
  if (!less.ok() || !more.ok()) return;
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    const auto column = static_cast<double>(i % static_cast<std::size_t>(columns_));
    const auto row = static_cast<double>(i / static_cast<std::size_t>(columns_));
    const Eigen::Vector2d pixel = kSpacing_px * Eigen::Vector2d(column, row);
    const auto ray = model.UnprojectTuned(pixel, tunable, nullptr);
    if (!ray) continue;
    const auto before = (*less)->ProjectTuned(*ray, tunable, nullptr);
    const auto after = (*more)->ProjectTuned(*ray, tunable, nullptr);
    if (!before || !after) continue;
    nodes_[i] = (*after - *before) / (2.0 * kStep);
    if (model.IsInImage(pixel)) largest_px_ = std::max(largest_px_, nodes_[i].norm());
  }
}

Eigen::Vector2d RadialField::At(const Eigen::Vector2d& pixel) const {
  const double x = std::clamp(pixel.x() / kSpacing_px, 0.0, columns_ - 1.0);
  const double y = std::clamp(pixel.y() / kSpacing_px, 0.0, rows_ - 1.0);
  const int column = std::min(static_cast<int>(x), columns_ - 2);
  const int row = std::min(static_cast<int>(y), rows_ - 2);
  const double right = x - column;
  const double down = y - row;
  const auto first = static_cast<std::size_t>(row * columns_ + column);
  const auto below = first + static_cast<std::size_t>(columns_);
  return (1.0 - down) * ((1.0 - right) * nodes_[first] + right * nodes_[first + 1]) +
         down * ((1.0 - right) * nodes_[below] + right * nodes_[below + 1]);
}

}  // namespace scenecalib
