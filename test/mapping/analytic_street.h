#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/mapping/surface_builder.h"

namespace scenecalib::testing {

/// What an exact ray meets.
struct StreetHit {
  enum class Thing { kRoad, kPavement, kKerb, kFacade, kPole, kParkedCar, kMovingCar };
  Thing thing = Thing::kRoad;
  double range_m = std::numeric_limits<double>::infinity();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
};

/// A street along x with exact intersections: a road sloping along x, a 12 cm kerb to a pavement at
/// y = 4, facades at y = 7 (with recesses 25 cm deep) and y = -7, a pole, a parked car (box) and,
/// when it has a speed, a moving one.
class AnalyticStreet {
 public:
  static constexpr double kSlope = 0.02;
  static constexpr double kKerb_m = 0.12;
  static constexpr double kKerbY_m = 4.0;
  static constexpr double kFacadeY_m = 7.0;
  static constexpr double kFacadeHeight_m = 5.0;
  static constexpr double kRecess_m = 0.25;
  double moving_car_speed_m_s = 10.0;
  bool has_moving_car = true;

  std::optional<StreetHit> Cast(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                                double time_s) const {
    StreetHit best;
    CastGround(origin, direction, &best);
    CastFacades(origin, direction, &best);
    CastPole(origin, direction, &best);
    CastBox(origin, direction, ParkedCar(), StreetHit::Thing::kParkedCar, &best);
    if (has_moving_car) {
      CastBox(origin, direction, MovingCar(time_s), StreetHit::Thing::kMovingCar, &best);
    }
    if (!std::isfinite(best.range_m)) return std::nullopt;
    return best;
  }

  static Eigen::AlignedBox3d ParkedCar() { return {Vec(6.0, -5.5, 0.3), Vec(10.0, -3.8, 1.6)}; }
  Eigen::AlignedBox3d MovingCar(double time_s) const {
    const double x = -12.0 + moving_car_speed_m_s * time_s;
    return {Vec(x, 1.2, 0.25), Vec(x + 4.0, 3.0, 1.7)};
  }

 private:
  static Eigen::Vector3d Vec(double x, double y, double z) { return {x, y, z}; }

  static void Consider(double range_m, const Eigen::Vector3d& normal, StreetHit::Thing thing,
                       StreetHit* best) {
    if (range_m > 0.01 && range_m < best->range_m) *best = {thing, range_m, normal};
  }

  static void CastGround(const Eigen::Vector3d& o, const Eigen::Vector3d& d, StreetHit* best) {
    const Eigen::Vector3d normal = Vec(-kSlope, 0.0, 1.0).normalized();
    for (const double step_m : {0.0, kKerb_m}) {
      const double range_m = normal.dot(Vec(0.0, 0.0, step_m) - o) / normal.dot(d);
      const bool on_pavement = (o + range_m * d).y() > kKerbY_m;
      if (on_pavement != (step_m > 0.0)) continue;
      Consider(range_m, normal, on_pavement ? StreetHit::Thing::kPavement : StreetHit::Thing::kRoad,
               best);
    }
    const double to_kerb_m = (kKerbY_m - o.y()) / d.y();
    const Eigen::Vector3d at_kerb = o + to_kerb_m * d;
    const double height_m = at_kerb.z() - kSlope * at_kerb.x();
    if (height_m > 0.0 && height_m < kKerb_m) {
      Consider(to_kerb_m, Vec(0.0, -1.0, 0.0), StreetHit::Thing::kKerb, best);
    }
  }

  static void CastFacades(const Eigen::Vector3d& o, const Eigen::Vector3d& d, StreetHit* best) {
    const double to_right_m = (-kFacadeY_m - o.y()) / d.y();
    if ((o + to_right_m * d).z() < kFacadeHeight_m) {
      Consider(to_right_m, Vec(0.0, 1.0, 0.0), StreetHit::Thing::kFacade, best);
    }
    // The recesses' bottoms, and the wall where there is none; their flanks are left open.
    for (const double depth_m : {0.0, kRecess_m}) {
      const double range_m = (kFacadeY_m + depth_m - o.y()) / d.y();
      const Eigen::Vector3d at = o + range_m * d;
      const double in_bay_m = at.x() - 4.0 * std::floor(at.x() / 4.0);
      const bool recess = in_bay_m > 1.0 && in_bay_m < 2.4 && at.z() > 1.0 && at.z() < 2.6;
      if (recess != (depth_m > 0.0) || at.z() > kFacadeHeight_m) continue;
      Consider(range_m, Vec(0.0, -1.0, 0.0), StreetHit::Thing::kFacade, best);
    }
  }

  static void CastPole(const Eigen::Vector3d& o, const Eigen::Vector3d& d, StreetHit* best) {
    const Eigen::Vector2d center(5.0, 4.8);
    constexpr double kRadius_m = 0.08;
    const Eigen::Vector2d offset = o.head<2>() - center;
    const double a = d.head<2>().squaredNorm();
    const double b = offset.dot(d.head<2>());
    const double discriminant = b * b - a * (offset.squaredNorm() - kRadius_m * kRadius_m);
    if (discriminant <= 0.0) return;
    const double range_m = (-b - std::sqrt(discriminant)) / a;
    const Eigen::Vector3d at = o + range_m * d;
    if (at.z() > 4.0) return;
    const Eigen::Vector2d outward = (at.head<2>() - center) / kRadius_m;
    Consider(range_m, Vec(outward.x(), outward.y(), 0.0), StreetHit::Thing::kPole, best);
  }

  static void CastBox(const Eigen::Vector3d& o, const Eigen::Vector3d& d,
                      const Eigen::AlignedBox3d& box, StreetHit::Thing thing, StreetHit* best) {
    double enter_m = 0.0;
    double leave_m = std::numeric_limits<double>::infinity();
    Eigen::Vector3d normal = Vec(0.0, 0.0, 1.0);
    for (int axis = 0; axis < 3; ++axis) {
      const double a = (box.min()[axis] - o[axis]) / d[axis];
      const double b = (box.max()[axis] - o[axis]) / d[axis];
      if (std::min(a, b) > enter_m) {
        enter_m = std::min(a, b);
        normal = Eigen::Vector3d::Zero();
        normal[axis] = d[axis] > 0.0 ? -1.0 : 1.0;
      }
      leave_m = std::min(leave_m, std::max(a, b));
    }
    if (enter_m > 0.0 && enter_m < leave_m) Consider(enter_m, normal, thing, best);
  }
};

/// Scans of a street by a lidar that drives along x, with the truth of every return.
struct StreetRecording {
  std::vector<RegisteredScan> scans;
  int num_returns = 0;  ///< beyond SurfaceOptions::min_range_m
  int num_moving_returns = 0;
};

struct StreetLidar {
  int num_scans = 30;
  int num_rings = 48;
  int num_columns = 720;
  double noise_m = 0.02;
  double speed_m_s = 5.0;
  double height_m = 2.0;
  std::uint64_t seed = 7;
  /// Where the lidar is at a time.
  Eigen::Vector3d PositionAt(double time_s) const {
    const double x = -4.0 + speed_m_s * time_s;
    return {x, -1.0, height_m + AnalyticStreet::kSlope * x};
  }
};

inline StreetRecording RecordStreet(const AnalyticStreet& street, const StreetLidar& lidar) {
  StreetRecording recording;
  Random random(lidar.seed);
  for (int i = 0; i < lidar.num_scans; ++i) {
    RegisteredScan scan;
    scan.stamp_ns = static_cast<Timestamp>(i) * 100000000;
    scan.lidar_in_map_m = lidar.PositionAt(0.1 * i + 0.05);
    for (int column = 0; column < lidar.num_columns; ++column) {
      const double time_s = 0.1 * i + 0.1 * column / lidar.num_columns;
      const Eigen::Vector3d origin = lidar.PositionAt(time_s);
      const double azimuth = 2.0 * M_PI * (column + random.Uniform()) / lidar.num_columns;
      for (int ring = 0; ring < lidar.num_rings; ++ring) {
        const double elevation = -0.43 + 0.70 * ring / lidar.num_rings;
        const Eigen::Vector3d direction(std::cos(azimuth) * std::cos(elevation),
                                        std::sin(azimuth) * std::cos(elevation),
                                        std::sin(elevation));
        const auto hit = street.Cast(origin, direction, time_s);
        const double noise_m = lidar.noise_m * random.Gaussian();
        if (!hit || hit->range_m > 60.0) continue;
        RegisteredPoint point;
        point.position_in_map_m = (origin + (hit->range_m + noise_m) * direction).cast<float>();
        point.time_offset_s = static_cast<float>(time_s - 0.1 * i);
        point.intensity = 1.0F;
        scan.points.push_back(point);
        if (hit->range_m < SurfaceOptions().min_range_m) continue;  // never used
        ++recording.num_returns;
        if (hit->thing == StreetHit::Thing::kMovingCar) ++recording.num_moving_returns;
      }
    }
    recording.scans.push_back(std::move(scan));
  }
  return recording;
}

}  // namespace scenecalib::testing
