#pragma once

#include <Eigen/Core>
#include <vector>

#include "scenecalib/sensor/camera_model.h"

namespace scenecalib {

/// How the pixels of a lens move with its radial coefficient (RadialCoefficient), at constant rays.
/// Sampled on a grid: it is smooth, and asked for at every term.
class RadialField {
 public:
  /// Zero everywhere when the lens is at the edge of what it may be.
  RadialField(const CameraModel& model, const TunableIntrinsics& tunable);

  /// px per unit of the coefficient; beyond the image that of its border, outside the lens' domain
  /// zero.
  Eigen::Vector2d At(const Eigen::Vector2d& pixel) const;
  /// The largest displacement in the image, px per unit.
  double largest_px() const { return largest_px_; }

 private:
  int columns_ = 0;
  int rows_ = 0;
  std::vector<Eigen::Vector2d> nodes_;
  double largest_px_ = 0.0;
};

}  // namespace scenecalib
