// How a world is put together, from the road outwards: ground, then what closes the view and stands
// along each side, then cars. What differs between the kinds of world is a table: world_layout.cc.

#include "scenecalib/simulation/world.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "scenecalib/simulation/props.h"
#include "world_draft.h"
#include "world_layout.h"

namespace scenecalib {

namespace {

void AddParkedCars(double side, WorldDraft* draft) {
  if (draft->layout().parked_share <= 0.0) return;
  const RoadCurve& road = draft->road();
  Random& random = draft->random();
  draft->Every(6.2, [&](double s) {
    if (random.Uniform() > draft->layout().parked_share) return;
    const double d = side * (RoadLayout::kLaneM + 1.0 + random.Uniform(-0.1, 0.1));
    const double turned = random.Uniform() < 0.15 ? M_PI : 0.0;
    const double heading =
        road.Heading(s) + (side > 0.0 ? M_PI : 0.0) + turned + random.Uniform(-0.04, 0.04);
    const Rigid3 map_from_car(
        Eigen::Quaterniond(Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ())),
        draft->Ground(s, d, -0.01));
    AddCar(map_from_car, draft->NextObject(), draft->NextRandom(), &draft->world().mesh);
  });
}

void AddMovingCars(int num_cars, double mean_speed_m_s, WorldDraft* draft) {
  Random& random = draft->random();
  for (int i = 0; i < num_cars; ++i) {
    MovingCar car;
    car.oncoming = i % 3 != 1;
    car.phase_rad = random.Uniform(0.0, 2.0 * M_PI);
    car.speed_m_s = mean_speed_m_s * random.Uniform(0.7, 1.0);
    car.offset_m =
        car.oncoming ? 25.0 + 22.0 * i + random.Uniform(0.0, 15.0) : 16.0 + 9.0 * (i / 3);
    AddCar(Rigid3(), draft->NextObject(), draft->NextRandom(), &car.mesh);
    draft->world().cars.push_back(std::move(car));
  }
}

}  // namespace

Status CheckWorldKind(const std::string& kind) {
  if (FindWorldLayout(kind) != nullptr) return Status::Ok();
  return Status::InvalidArgument("world.kind is '" + kind + "'; known are " + KnownWorldKinds());
}

std::string KnownWorldKinds() {
  const std::vector<WorldLayout>& layouts = WorldLayouts();
  std::string names;
  for (std::size_t i = 0; i < layouts.size(); ++i) {
    if (i > 0) names += i + 1 < layouts.size() ? ", " : " and ";
    names += layouts[i].kind;
  }
  return names;
}

double CornerRadius(const std::string& kind) { return FindWorldLayout(kind)->corner_radius_m; }

World BuildWorld(const SimulatedWorldOptions& options, const RoadCurve& road, double mean_speed_m_s,
                 Random random) {
  WorldDraft draft(*FindWorldLayout(options.kind), road, random);
  AddGround(&draft);
  for (const double side : {-1.0, 1.0}) {
    AddBuildings(side, &draft);
    AddAlong(side, &draft);
    AddParkedCars(side, &draft);
  }
  AddEnds(&draft);
  AddMovingCars(options.num_moving_cars, mean_speed_m_s, &draft);
  return std::move(draft.world());
}

Rigid3 MapFromCar(const MovingCar& car, const RoadCurve& road, const VehicleMotion& motion,
                  double time_s) {
  double s = 0.0;
  double d = 0.0;
  if (car.oncoming) {
    s = car.offset_m - car.speed_m_s * time_s + 1.5 * std::sin(0.6 * time_s + car.phase_rad);
    d = 1.65;
  } else {
    s = motion.ArcLength(time_s) + car.offset_m + 2.5 * std::sin(0.45 * time_s + car.phase_rad);
    d = -1.65;
  }
  // Beyond the ends of the road a car waits out of sight.
  s = std::clamp(s, road.start_s_m(), road.end_s_m());
  const double slope = (road.HillHeight(s + 1.3) - road.HillHeight(s - 1.3)) / 2.6;
  const double heading = road.Heading(s) + (car.oncoming ? M_PI : 0.0);
  const double pitch = std::atan(slope) * (car.oncoming ? 1.0 : -1.0);
  const Eigen::Quaterniond rotation = Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ()) *
                                      Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY());
  return {rotation, road.Point(s, d, -0.0025 * d * d)};
}

}  // namespace scenecalib
