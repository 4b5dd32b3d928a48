#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/base/status.h"
#include "scenecalib/simulation/mesh.h"
#include "scenecalib/simulation/road_curve.h"
#include "scenecalib/simulation/simulation_options.h"
#include "scenecalib/simulation/vehicle_motion.h"

namespace scenecalib {

/// Another car that drives: with us, keeping about its distance, or against us.
struct MovingCar {
  Mesh mesh;  ///< in the car's own frame (see AddCar)
  bool oncoming = false;
  double offset_m = 0.0;  ///< ahead of us, or arc length at time 0 when oncoming
  double speed_m_s = 0.0;
  double phase_rad = 0.0;
};

/// Everything that can be seen, in the map frame.
struct World {
  Mesh mesh;
  Mesh shadow_mesh;  ///< casts shadows in place of single leaves
  std::vector<MovingCar> cars;
  Eigen::Vector3d towards_sun = Eigen::Vector3d::UnitZ();
};

/// The kinds of world for a person: "street, suburb, ... and village".
std::string KnownWorldKinds();

/// InvalidArgument for an unknown kind; the message names the known ones.
Status CheckWorldKind(const std::string& kind);

/// Sharpest corner (metres) that a world of a valid kind has room for.
double CornerRadius(const std::string& kind);

/// Builds the world along the road. `options.kind` is known to be valid.
World BuildWorld(const SimulatedWorldOptions& options, const RoadCurve& road, double mean_speed_m_s,
                 Random random);

/// Pose of a moving car at a time.
Rigid3 MapFromCar(const MovingCar& car, const RoadCurve& road, const VehicleMotion& motion,
                  double time_s);

}  // namespace scenecalib
