#include "scenecalib/simulation/own_vehicle.h"

#include <algorithm>
#include <limits>

namespace scenecalib {

bool OwnVehicle::Contains(const Eigen::Vector3d& point_in_vehicle_m) const {
  constexpr double kMargin = 0.05;  // metres
  return std::any_of(boxes.begin(), boxes.end(), [&](const Box& box) {
    return ((point_in_vehicle_m - box.low_m).array() > -kMargin).all() &&
           ((box.high_m - point_in_vehicle_m).array() > -kMargin).all();
  });
}

OwnVehicle MakeOwnVehicle(double lidar_height_m) {
  OwnVehicle vehicle;
  // Beyond any texture seed that a world draws by chance; the id is above all of the world's.
  Surface paint;
  paint.material = Material::kCarPaint;
  paint.albedo = {0.45F, 0.42F, 0.4F};
  paint.seed = 4242U;
  paint.object_id = std::numeric_limits<std::uint32_t>::max();
  const std::uint32_t surface = vehicle.mesh.AddSurface(paint);
  vehicle.boxes = {{{2.3, -0.8, 0.5}, {3.0, 0.8, 0.98}},  // bonnet, in two steps
                   {{3.0, -0.78, 0.45}, {3.62, 0.78, 0.9}},
                   {{-0.9, -0.88, 0.3}, {2.3, 0.88, 0.95}}};  // doors
  const double roof_m = std::min(1.45, lidar_height_m - 0.35);
  if (roof_m > 1.0) vehicle.boxes.push_back({{-0.7, -0.65, roof_m - 0.08}, {1.25, 0.65, roof_m}});
  for (const OwnVehicle::Box& box : vehicle.boxes) {
    vehicle.mesh.AddBox(Rigid3(Eigen::Quaterniond::Identity(), box.low_m), box.high_m - box.low_m,
                        surface);
  }
  return vehicle;
}

}  // namespace scenecalib
