#include "scenecalib/simulation/road_curve.h"

#include <algorithm>
#include <cmath>

#include "scenecalib/simulation/noise.h"

namespace scenecalib {

namespace {

constexpr double kStep = 0.05;  // metres between stored points of the centreline

/// Turn of a bend up to its middle plus x half lengths (x in [-1, 1]): from 0 to 1, with the
/// curvature (its derivative) a smooth bump 35/32 (1 - x^2)^3.
double BendShare(double x) {
  if (x <= -1.0) return 0.0;
  if (x >= 1.0) return 1.0;
  const double x2 = x * x;
  return 0.5 + 35.0 / 32.0 * x * (1.0 - x2 + 0.6 * x2 * x2 - x2 * x2 * x2 / 7.0);
}

double BendDensity(double x) {
  if (std::abs(x) >= 1.0) return 0.0;
  const double b = 1.0 - x * x;
  return 35.0 / 32.0 * b * b * b;
}

}  // namespace

RoadCurve::RoadCurve(const std::string& drive_kind, double start_s_m, double drive_length_m,
                     double end_s_m, double corner_radius_m, Random random)
    : start_s_m_(start_s_m),
      end_s_m_(end_s_m),
      bump_seed_(static_cast<std::uint32_t>(random.NextBits())) {
  // Corners and gentle bends alternate each for themselves: their turns must not add up.
  double corner_sign = random.Uniform() < 0.5 ? -1.0 : 1.0;
  double gentle_sign = -corner_sign;
  if (drive_kind != "straight") {
    // Gentle bends and, for "turns", corners; in alternating direction, none overlapping.
    bool corner_next = drive_kind == "turns";
    double s = random.Uniform(0.0, 4.0);
    while (s < drive_length_m) {
      Bend bend;
      bend.angle_rad = corner_next ? random.Uniform(1.2, 1.55) : random.Uniform(0.25, 0.5);
      // The sharpest curvature is 35/32 * angle / half_length.
      const double radius_m = corner_next ? corner_radius_m : random.Uniform(35.0, 60.0);
      bend.half_length_m = 35.0 / 32.0 * bend.angle_rad * radius_m;
      bend.middle_s_m = s + bend.half_length_m;
      double& sign = corner_next ? corner_sign : gentle_sign;
      bend.angle_rad *= sign;
      sign = -sign;
      bends_.push_back(bend);
      s = bend.middle_s_m + bend.half_length_m + random.Uniform(4.0, 14.0);
      if (drive_kind == "turns") corner_next = !corner_next;
    }
  }
  for (int i = 0; i < 4; ++i) {
    Wave wave;
    wave.wavelength_m = 28.0 * std::pow(1.7, i) * random.Uniform(0.9, 1.1);
    wave.amplitude_m = 0.0022 * wave.wavelength_m * random.Uniform(0.6, 1.2);
    wave.phase_rad = random.Uniform(0.0, 2.0 * M_PI);
    hills_.push_back(wave);
  }
  // Integrate the heading with Simpson's rule, from the start; then shift s = 0 to the origin.
  const auto num_steps = static_cast<std::size_t>(std::ceil((end_s_m - start_s_m) / kStep)) + 1;
  points_.reserve(num_steps + 1);
  Eigen::Vector2d point = Eigen::Vector2d::Zero();
  const auto direction = [this](double s) {
    const double heading = Heading(s);
    return Eigen::Vector2d(std::cos(heading), std::sin(heading));
  };
  for (std::size_t i = 0; i <= num_steps; ++i) {
    points_.push_back(point);
    const double s = start_s_m + static_cast<double>(i) * kStep;
    point += kStep / 6.0 * (direction(s) + 4.0 * direction(s + 0.5 * kStep) + direction(s + kStep));
  }
  const Eigen::Vector3d origin = Point(0.0, 0.0, 0.0);
  for (Eigen::Vector2d& p : points_) p -= origin.head<2>();
}

double RoadCurve::Heading(double s) const {
  double heading = 0.0;
  for (const Bend& bend : bends_) {
    heading += bend.angle_rad * BendShare((s - bend.middle_s_m) / bend.half_length_m);
  }
  return heading;
}

double RoadCurve::Curvature(double s) const {
  double curvature = 0.0;
  for (const Bend& bend : bends_) {
    curvature += bend.angle_rad / bend.half_length_m *
                 BendDensity((s - bend.middle_s_m) / bend.half_length_m);
  }
  return curvature;
}

double RoadCurve::HillHeight(double s) const {
  double height_m = 0.0;
  for (const Wave& wave : hills_) {
    height_m += wave.amplitude_m * std::sin(2.0 * M_PI * s / wave.wavelength_m + wave.phase_rad);
  }
  return height_m;
}

double RoadCurve::BumpHeight(double s, double d) const {
  const auto x = static_cast<float>(s);
  const auto y = static_cast<float>(d);
  return 0.015 * ValueNoise(x / 4.1F, y / 3.1F, bump_seed_) +
         0.006 * ValueNoise(x / 1.7F, y / 1.3F, bump_seed_ + 1U);
}

double RoadCurve::RoadHeight(double s, double d) const {
  const double crown_m = -0.0025 * d * d;  // 7 cm lower at the kerb: about 2.5 percent
  return HillHeight(s) + crown_m + BumpHeight(s, d);
}

Eigen::Vector3d RoadCurve::Point(double s, double d, double height_m) const {
  const double clamped = std::clamp(s, start_s_m_, end_s_m_);
  const auto index =
      std::min(static_cast<std::size_t>((clamped - start_s_m_) / kStep), points_.size() - 2);
  // From the nearest stored point along an arc of the local heading and curvature: exact to 1e-7 m.
  const double base_s = start_s_m_ + static_cast<double>(index) * kStep;
  const double rest = s - base_s;
  const double middle_heading = Heading(base_s + 0.5 * rest);
  const Eigen::Vector2d on_line =
      points_[index] + rest * Eigen::Vector2d(std::cos(middle_heading), std::sin(middle_heading));
  const Eigen::Vector3d left = Left(s);
  return {on_line.x() + d * left.x(), on_line.y() + d * left.y(), HillHeight(s) + height_m};
}

Eigen::Vector3d RoadCurve::Along(double s) const {
  const double heading = Heading(s);
  return {std::cos(heading), std::sin(heading), 0.0};
}

Eigen::Vector3d RoadCurve::Left(double s) const {
  const double heading = Heading(s);
  return {-std::sin(heading), std::cos(heading), 0.0};
}

}  // namespace scenecalib
