#include "scenecalib/simulation/vehicle_motion.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace scenecalib {

namespace {

constexpr int kDegree = 5;
constexpr double kKnotStep = 0.05;  // seconds; passes motions up to some Hz, as a car's are
constexpr double kLateralAcceleration = 2.6;  // m/s^2, what a driver takes in a corner

/// The degree + 1 basis functions of a uniform B-spline that are not zero at fraction u of a knot
/// interval (de Boor's recursion with integer knots).
template <int kBasisDegree>
std::array<double, kBasisDegree + 1> UniformBasis(double u) {
  std::array<double, kBasisDegree + 1> basis{};
  basis[0] = 1.0;
  for (int k = 1; k <= kBasisDegree; ++k) {
    double saved = 0.0;
    for (int r = 0; r < k; ++r) {
      const double share = basis[r] / k;
      basis[r] = saved + (r + 1 - u) * share;
      saved = (u + k - 1 - r) * share;
    }
    basis[k] = saved;
  }
  return basis;
}

/// A sum of three sines, amplitude about 1: how springs answer to a road.
class Wobble {
 public:
  explicit Wobble(Random* random) {
    const double frequencies_hz[3] = {0.95, 1.4, 1.95};
    for (int i = 0; i < 3; ++i) {
      frequency_rad_s_[i] = 2.0 * M_PI * frequencies_hz[i] * random->Uniform(0.85, 1.15);
      phase_rad_[i] = random->Uniform(0.0, 2.0 * M_PI);
    }
  }
  double At(double time_s) const {
    const double amplitudes[3] = {0.5, 0.3, 0.2};
    double sum = 0.0;
    for (int i = 0; i < 3; ++i) {
      sum += amplitudes[i] * std::sin(frequency_rad_s_[i] * time_s + phase_rad_[i]);
    }
    return sum;
  }

 private:
  double frequency_rad_s_[3];
  double phase_rad_[3];
};

/// Speed at a place on the road: slower in bends, and varying along the way.
class SpeedProfile {
 public:
  SpeedProfile(const RoadCurve& road, const SimulatedDriveOptions& options, Random* random)
      : road_(road),
        speed_m_s_(options.speed_m_s),
        variation_(options.speed_variation),
        phase_rad_(random->Uniform(0.0, 2.0 * M_PI)) {}

  double At(double s) const {
    const double wavelength_m = 4.5 * speed_m_s_ + 6.0;
    const double free =
        speed_m_s_ * (1.0 + variation_ * std::sin(2.0 * M_PI * s / wavelength_m + phase_rad_));
    const double ratio = free * free * road_.Curvature(s) / kLateralAcceleration;
    return free / std::pow(1.0 + ratio * ratio, 0.25);
  }

  /// Arc length after `step_s` seconds from s (Runge-Kutta; negative steps go back).
  double Advance(double s, double step_s) const {
    const double k1 = At(s);
    const double k2 = At(s + 0.5 * step_s * k1);
    const double k3 = At(s + 0.5 * step_s * k2);
    const double k4 = At(s + step_s * k3);
    return s + step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
  }

 private:
  const RoadCurve& road_;
  double speed_m_s_, variation_, phase_rad_;
};

}  // namespace

double VehicleMotion::LaneOffset(double s) { return -1.65 + 0.2 * std::sin(2.0 * M_PI * s / 37.0); }

VehicleMotion::VehicleMotion(const RoadCurve& road, const SimulatedDriveOptions& options,
                             double start_s, double end_s, Random random) {
  const SpeedProfile speed(road, options, &random);
  const Wobble heave(&random);
  const Wobble pitch(&random);
  const Wobble roll(&random);
  // Control points sit at the middle of their basis functions, half a degree beyond both ends.
  const int first = static_cast<int>(std::floor(start_s / kKnotStep)) - kDegree;
  const int last = static_cast<int>(std::ceil(end_s / kKnotStep)) + kDegree;
  first_knot_s_ = first * kKnotStep;
  std::vector<double> arc(static_cast<std::size_t>(last - first + 1));
  double s = 0.0;
  for (int i = 0; i <= last; ++i, s = speed.Advance(s, kKnotStep)) {
    if (i >= first) arc[static_cast<std::size_t>(i - first)] = s;
  }
  s = 0.0;
  for (int i = 0; i >= first; --i, s = speed.Advance(s, -kKnotStep)) {
    if (i <= last) arc[static_cast<std::size_t>(i - first)] = s;
  }
  const double suspension_rad = options.suspension_deg * M_PI / 180.0;
  for (int i = first; i <= last; ++i) {
    const double t = i * kKnotStep;
    const double here = arc[static_cast<std::size_t>(i - first)];
    const double offset = LaneOffset(here);
    const double curvature = road.Curvature(here);
    const double lane_slope = (LaneOffset(here + 0.1) - LaneOffset(here - 0.1)) / 0.2;
    const double hill_slope = (road.HillHeight(here + 2.7) - road.HillHeight(here)) / 2.7;
    const double v = speed.At(here);
    const double forward = v * (speed.At(here + 0.5) - speed.At(here - 0.5));
    const Eigen::Vector3d position =
        road.Point(here, offset, options.suspension_m * heave.At(t) - 0.0025 * offset * offset);
    Coordinates c;
    c.head<3>() = position;
    c[3] = road.Heading(here) + std::atan2(lane_slope, 1.0 - curvature * offset);
    // Nose down is positive: uphill and throttle lift it; in a left turn the body leans right.
    c[4] = -std::atan(hill_slope) - 0.004 * forward + suspension_rad * pitch.At(t);
    c[5] = 0.006 * v * v * curvature + suspension_rad * roll.At(t);
    c[6] = here;
    control_.push_back(c);
  }
}

VehicleMotion::Coordinates VehicleMotion::Evaluate(double time_s, int order) const {
  // Basis function i is centred on control point i: the interval [j, j + 1] uses points j - 2 to
  // j + 3.
  const double position = (time_s - first_knot_s_) / kKnotStep;
  const auto interval =
      std::clamp(static_cast<int>(std::floor(position)), 2, static_cast<int>(control_.size()) - 4);
  const double u = position - interval;
  const Coordinates* c = &control_[static_cast<std::size_t>(interval - 2)];
  Coordinates sum = Coordinates::Zero();
  if (order == 0) {
    const auto basis = UniformBasis<5>(u);
    for (int i = 0; i < 6; ++i) sum += basis[i] * c[i];
  } else if (order == 1) {
    const auto basis = UniformBasis<4>(u);
    for (int i = 0; i < 5; ++i) sum += basis[i] * (c[i + 1] - c[i]);
    sum /= kKnotStep;
  } else {
    const auto basis = UniformBasis<3>(u);
    for (int i = 0; i < 4; ++i) sum += basis[i] * (c[i + 2] - 2.0 * c[i + 1] + c[i]);
    sum /= kKnotStep * kKnotStep;
  }
  return sum;
}

Rigid3 VehicleMotion::MapFromVehicle(double time_s) const {
  const Coordinates c = Evaluate(time_s, 0);
  const Eigen::Quaterniond rotation = Eigen::AngleAxisd(c[3], Eigen::Vector3d::UnitZ()) *
                                      Eigen::AngleAxisd(c[4], Eigen::Vector3d::UnitY()) *
                                      Eigen::AngleAxisd(c[5], Eigen::Vector3d::UnitX());
  return {rotation, c.head<3>()};
}

double VehicleMotion::ArcLength(double time_s) const { return Evaluate(time_s, 0)[6]; }

Eigen::Vector3d VehicleMotion::AngularVelocity(double time_s) const {
  const Coordinates c = Evaluate(time_s, 0);
  const Coordinates rate = Evaluate(time_s, 1);
  const double sin_pitch = std::sin(c[4]), cos_pitch = std::cos(c[4]);
  const double sin_roll = std::sin(c[5]), cos_roll = std::cos(c[5]);
  return {rate[5] - rate[3] * sin_pitch, rate[4] * cos_roll + rate[3] * cos_pitch * sin_roll,
          -rate[4] * sin_roll + rate[3] * cos_pitch * cos_roll};
}

VehicleState VehicleMotion::At(double time_s) const {
  VehicleState state;
  state.map_from_vehicle = MapFromVehicle(time_s);
  state.velocity_in_map_m_s = Evaluate(time_s, 1).head<3>();
  state.acceleration_in_map_m_s2 = Evaluate(time_s, 2).head<3>();
  state.angular_velocity_in_vehicle_rad_s = AngularVelocity(time_s);
  // The spline's angles are smooth enough for a central difference to be good to 1e-7 rad/s^2.
  constexpr double kStep = 1e-4;
  state.angular_acceleration_in_vehicle_rad_s2 =
      (AngularVelocity(time_s + kStep) - AngularVelocity(time_s - kStep)) / (2.0 * kStep);
  return state;
}

}  // namespace scenecalib
