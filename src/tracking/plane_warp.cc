#include "scenecalib/tracking/plane_warp.h"

#include <Eigen/LU>
#include <cmath>

namespace scenecalib {
namespace {

constexpr int kNumBorder = 8;

/// The middle and the border of a square.
const std::array<Eigen::Vector2d, 1 + kNumBorder> kSquare = {
    Eigen::Vector2d(0, 0),  Eigen::Vector2d(-1, -1), Eigen::Vector2d(0, -1),
    Eigen::Vector2d(1, -1), Eigen::Vector2d(-1, 0),  Eigen::Vector2d(1, 0),
    Eigen::Vector2d(-1, 1), Eigen::Vector2d(0, 1),   Eigen::Vector2d(1, 1)};

/// Of values at the square's border to the coefficients of x, y, x^2, x y and y^2: least squares.
Eigen::Matrix<double, 5, kNumBorder> SecondOrderFit() {
  Eigen::Matrix<double, kNumBorder, 5> design;
  for (int i = 0; i < kNumBorder; ++i) {
    const double x = kSquare[i + 1].x();
    const double y = kSquare[i + 1].y();
    design.row(i) << x, y, x * x, x * y, y * y;
  }
  return (design.transpose() * design).inverse() * design.transpose();
}

}  // namespace

std::optional<Eigen::Vector3d> MeetPlane(const PosedView& view, const MapPlane& plane,
                                         const Eigen::Vector2d& pixel, double min_grazing_sine) {
  const auto ray = view.model->Unproject(pixel);
  if (!ray) return std::nullopt;
  const Rigid3 map_from_camera = view.pose->At(pixel.y());
  const Eigen::Vector3d direction = map_from_camera.rotation * *ray;
  const double sine = plane.normal_in_map.dot(direction);
  const double height = plane.normal_in_map.dot(plane.point_in_map_m - map_from_camera.translation);
  if (std::abs(sine) < min_grazing_sine || height / sine <= 0.0) return std::nullopt;
  return Eigen::Vector3d(map_from_camera.translation + height / sine * direction);
}

std::optional<PlaneSamples> SamplePlane(const PosedView& view, const MapPlane& plane,
                                        const Eigen::Vector2d& pixel, double half_edge_px,
                                        double min_grazing_sine) {
  PlaneSamples samples;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const auto point = MeetPlane(view, plane, pixel + half_edge_px * kSquare[i], min_grazing_sine);
    if (!point) return std::nullopt;
    samples[i] = *point;
  }
  return samples;
}

std::optional<PatchWarp> WarpInto(const PosedView& view, const PlaneSamples& samples,
                                  double half_edge_px) {
  static const Eigen::Matrix<double, 5, kNumBorder> kFit = SecondOrderFit();
  const auto centre = view.pose->Project(*view.model, samples[0]);
  if (!centre) return std::nullopt;
  Eigen::Matrix<double, kNumBorder, 2> pixels;
  for (int i = 0; i < kNumBorder; ++i) {
    const auto pixel = view.pose->Project(*view.model, samples[i + 1]);
    if (!pixel) return std::nullopt;
    pixels.row(i) = (*pixel - *centre).transpose();
  }
  const Eigen::Matrix<double, 5, 2> fit = kFit * pixels;
  PatchWarp warp;
  warp.center_px = *centre;
  warp.affine = fit.topRows<2>().transpose() / half_edge_px;
  warp.quadratic = fit.bottomRows<3>().transpose() / (half_edge_px * half_edge_px);
  return warp;
}

}  // namespace scenecalib
