#pragma once

#include <functional>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/simulation/simulation_options.h"
#include "scenecalib/simulation/vehicle_motion.h"

namespace scenecalib {

constexpr double kGravityM_s2 = 9.81;  ///< along -z of the map

/// What an IMU mounted at vehicle_from_imu feels in that state of motion, without noise: angular
/// rate, and specific force with the lever arm's share, in the IMU frame.
ImuSample PerfectImu(const VehicleState& state, const Rigid3& vehicle_from_imu);

/// IMU samples at the stamps, with white noise and walking biases. `state_at` gives the true
/// motion.
std::vector<ImuSample> SimulateImu(const std::vector<Timestamp>& stamps_ns,
                                   const std::function<VehicleState(Timestamp)>& state_at,
                                   const Rigid3& vehicle_from_imu,
                                   const SimulatedImuOptions& options, Random random);

/// Dead reckoning of a body at the stamps: the first sample is the identity, every increment has a
/// misjudged length, a yaw drift and noise.
std::vector<OdometrySample> SimulateOdometry(
    const std::vector<Timestamp>& stamps_ns,
    const std::function<Rigid3(Timestamp)>& map_from_body_at,
    const SimulatedOdometryOptions& options, Random random);

}  // namespace scenecalib
