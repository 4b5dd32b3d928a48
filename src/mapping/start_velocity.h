#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "sweep_alignment.h"
#include "sweep_motion.h"

namespace scenecalib {

/// One of the first two sweeps: everything that enters the map, and what is registered.
struct StartSweep {
  const SweepSamples& samples;
  const std::vector<SweepPoint>& source;
  const SweepMotion& motion;
};

struct StartVelocity {
  LidarVelocity velocity;
  /// Along it other velocities explain both sweeps as well: the scene does not tell the speed.
  std::optional<Eigen::Vector3d> open_direction_in_map;
};

/// The velocity of a vehicle that moves already when the first scan arrives, to within the basin of
/// the registration: tries standing, speeds up to 40 m/s in every horizontal direction of the lidar
/// and turns on the spot, deskews both sweeps with each and takes the one under which the second
/// fits best onto the first. Registration from rest alone locks onto the wrong bay of a facade.
StartVelocity SearchStartVelocity(const StartSweep& first, const StartSweep& second,
                                  const LastSweep& last, const MotionPrior& prior,
                                  const AlignmentOptions& options);

}  // namespace scenecalib
