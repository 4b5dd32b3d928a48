#pragma once

#include <functional>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/base/timestamp.h"
#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/simulation/scene_tracer.h"
#include "scenecalib/simulation/simulation_options.h"

namespace scenecalib {

/// Where everything is at one instant.
struct SceneInstant {
  Rigid3 map_from_lidar;
  std::vector<Rigid3> map_from_object;  ///< of the tracer's moving objects
};

/// One of a lidar's lasers: where it is said to point to, and how far that and its ranges are off.
struct Laser {
  double elevation_rad = 0.0;
  double elevation_error_rad = 0.0;  ///< true less reported
  double azimuth_error_rad = 0.0;    ///< true less reported
  double range_error_m = 0.0;        ///< measured less true
};

/// The lasers of one lidar, lowest first; errors drawn from `random`.
std::vector<Laser> MakeLasers(const SimulatedLidarOptions& options, Random random);

/// Casts one turn of a spinning lidar: every column of lasers at its own time, clockwise seen from
/// above, beginning at the rear. Points are in the lidar frame at their own time, stamped with the
/// first column's. All of TBB's threads; the same for any number of them.
LidarScan CastLidarScan(const SceneTracer& tracer, const SimulatedLidarOptions& options,
                        const std::vector<Laser>& lasers, bool sees_own_vehicle, Timestamp start_ns,
                        std::uint64_t noise_seed,
                        const std::function<SceneInstant(Timestamp)>& instant_at);

}  // namespace scenecalib
