#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/simulation/road_curve.h"
#include "scenecalib/simulation/simulation_options.h"

namespace scenecalib {

/// Pose and motion of the vehicle at one instant.
struct VehicleState {
  Rigid3 map_from_vehicle;
  Eigen::Vector3d velocity_in_map_m_s = Eigen::Vector3d::Zero();
  Eigen::Vector3d acceleration_in_map_m_s2 = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_velocity_in_vehicle_rad_s = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_acceleration_in_vehicle_rad_s2 = Eigen::Vector3d::Zero();
};

/// The recording vehicle's drive along its lane: a uniform quintic B-spline (four times
/// continuously differentiable) of position, yaw, pitch and roll, so that every derivative an IMU
/// feels is exact. The vehicle frame is x forward, y left, z up, its origin on the ground below the
/// rear axle.
class VehicleMotion {
 public:
  /// Covers [start_s, end_s] seconds. `road` must reach as far as the drive goes.
  VehicleMotion(const RoadCurve& road, const SimulatedDriveOptions& options, double start_s,
                double end_s, Random random);

  VehicleState At(double time_s) const;
  Rigid3 MapFromVehicle(double time_s) const;
  /// Arc length along the road, metres: 0 at time 0.
  double ArcLength(double time_s) const;

  /// Where in its lane the vehicle drives: on the right of the centreline.
  static double LaneOffset(double s);

 private:
  /// x, y, z, yaw, pitch, roll, arc length.
  using Coordinates = Eigen::Matrix<double, 7, 1>;

  /// The spline's value (order 0) or derivative (1 or 2).
  Coordinates Evaluate(double time_s, int order) const;
  Eigen::Vector3d AngularVelocity(double time_s) const;

  double first_knot_s_;
  std::vector<Coordinates> control_;
};

}  // namespace scenecalib
