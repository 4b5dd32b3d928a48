#include "../../src/mapping/moving_objects.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <functional>
#include <limits>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr double kLidarHeightM = 1.9;
constexpr double kScanPeriodS = 0.1;
constexpr double kMinRangeM = 3.0;

/// A straight street with flat ground, facades, parked cars along both sides and one moving car.
struct Scene {
  int num_scans = 50;
  double speed_m_s = 6.0;
  /// Rear left lower corner of the moving car's box, 4.4 x 1.8 x 1.5 m.
  std::function<Eigen::Vector3d(double time_s)> car_at;
  /// Its footprint is turned by a right angle.
  bool car_is_across = false;

  Eigen::AlignedBox3d Car(double time_s) const {
    const Eigen::Vector3d corner = car_at(time_s);
    const Eigen::Vector3d size =
        car_is_across ? Eigen::Vector3d(1.8, 4.4, 1.5) : Eigen::Vector3d(4.4, 1.8, 1.5);
    return {corner, corner + size};
  }
};

enum class Thing { kGround, kParked, kStructure, kCar };

std::vector<std::pair<Eigen::AlignedBox3d, Thing>> StaticBoxes() {
  std::vector<std::pair<Eigen::AlignedBox3d, Thing>> boxes;
  for (const double side : {-1.0, 1.0}) {
    const double y = side > 0.0 ? 9.0 : -10.0;
    boxes.push_back({{Eigen::Vector3d(-60.0, y, 0.0), Eigen::Vector3d(120.0, y + 1.0, 8.0)},
                     Thing::kStructure});
    for (int i = -4; i < 10; ++i) {
      const Eigen::Vector3d corner(7.0 * i, side > 0.0 ? 4.6 : -6.4, 0.15);
      boxes.push_back({{corner, corner + Eigen::Vector3d(4.4, 1.8, 1.35)}, Thing::kParked});
    }
  }
  return boxes;
}

double Enter(const Eigen::AlignedBox3d& box, const Eigen::Vector3d& origin,
             const Eigen::Vector3d& direction) {
  const Eigen::Array3d a = (box.min() - origin).array() / direction.array();
  const Eigen::Array3d b = (box.max() - origin).array() / direction.array();
  const double enter = a.min(b).maxCoeff();
  return enter > 0.0 && enter < a.max(b).minCoeff() ? enter
                                                    : std::numeric_limits<double>::infinity();
}

struct Shares {
  double car_removed = 0.0;
  double parked_lost = 0.0;
  double static_lost = 0.0;
  int num_car = 0;
};

Shares Remove(const Scene& scene) {
  const auto boxes = StaticBoxes();
  Random random(11);
  std::vector<LidarReturn> points;
  std::vector<Thing> things;
  std::vector<PointLabel> labels;
  for (int scan = 0; scan < scene.num_scans; ++scan) {
    for (int column = 0; column < 600; ++column) {
      const double time_s = kScanPeriodS * (scan + column / 600.0);
      const Eigen::Vector3d origin(scene.speed_m_s * time_s, -1.7, kLidarHeightM);
      const Eigen::AlignedBox3d car = scene.Car(time_s);
      const double azimuth = 2.0 * M_PI * column / 600.0;
      for (int ring = 0; ring < 40; ++ring) {
        const double elevation = -0.40 + 0.6 * ring / 40.0;
        const Eigen::Vector3d direction(std::cos(azimuth) * std::cos(elevation),
                                        std::sin(azimuth) * std::cos(elevation),
                                        std::sin(elevation));
        double range_m = std::numeric_limits<double>::infinity();
        Thing thing = Thing::kGround;
        if (direction.z() < 0.0) range_m = -kLidarHeightM / direction.z();
        for (const auto& [box, kind] : boxes) {
          const double enter_m = Enter(box, origin, direction);
          if (enter_m < range_m) thing = kind;
          range_m = std::min(range_m, enter_m);
        }
        const double enter_m = Enter(car, origin, direction);
        if (enter_m < range_m) thing = Thing::kCar;
        range_m = std::min(range_m, enter_m);
        if (!(range_m < 70.0 && range_m > kMinRangeM)) continue;
        range_m += 0.02 * random.Gaussian();
        LidarReturn point;
        point.position_m = (origin + range_m * direction).cast<float>();
        point.origin_m = origin.cast<float>();
        point.scan = scan;
        points.push_back(point);
        things.push_back(thing);
        labels.push_back(point.position_m.z() < 0.07F ? PointLabel::kGround
                                                      : PointLabel::kStructure);
      }
    }
  }
  const int num_removed = RemoveMovingObjects(points, MovingObjectOptions(), &labels);
  std::array<int, 4> all{};
  std::array<int, 4> removed{};
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto kind = static_cast<std::size_t>(things[i]);
    ++all[kind];
    if (labels[i] == PointLabel::kMoving) ++removed[kind];
  }
  EXPECT_EQ(num_removed, removed[0] + removed[1] + removed[2] + removed[3]);
  const auto share = [&](Thing thing) {
    const auto kind = static_cast<std::size_t>(thing);
    return static_cast<double>(removed[kind]) / all[kind];
  };
  Shares shares;
  shares.num_car = all[static_cast<std::size_t>(Thing::kCar)];
  shares.car_removed = share(Thing::kCar);
  shares.parked_lost = share(Thing::kParked);
  shares.static_lost = static_cast<double>(removed[0] + removed[1] + removed[2]) /
                       static_cast<double>(all[0] + all[1] + all[2]);
  return shares;
}

constexpr double kMinRemoved = 0.95;
constexpr double kMaxLost = 0.02;

void ExpectRemoved(const Scene& scene) {
  const Shares shares = Remove(scene);
  ASSERT_GT(shares.num_car, 1000);
  EXPECT_GT(shares.car_removed, kMinRemoved);
  EXPECT_LT(shares.static_lost, kMaxLost);
  EXPECT_LT(shares.parked_lost, kMaxLost);
}

TEST(RemoveMovingObjects, RemovesAnOncomingCar) {
  Scene scene;
  scene.car_at = [](double t) { return Eigen::Vector3d(50.0 - 9.0 * t, 1.0, 0.15); };
  ExpectRemoved(scene);
}

TEST(RemoveMovingObjects, RemovesACarAheadThatKeepsItsDistanceToTheEnd) {
  Scene scene;
  scene.car_at = [](double t) { return Eigen::Vector3d(14.0 + 6.0 * t, -2.6, 0.15); };
  ExpectRemoved(scene);
}

TEST(RemoveMovingObjects, RemovesACrossingCar) {
  Scene scene;
  scene.car_is_across = true;  // between two parked cars on either side
  scene.car_at = [](double t) { return Eigen::Vector3d(25.8, -14.0 + 6.0 * t, 0.15); };
  ExpectRemoved(scene);
}

TEST(RemoveMovingObjects, RemovesACarThatBrakesToAStandstill) {
  Scene scene;
  scene.speed_m_s = 4.0;
  scene.car_at = [](double t) {
    const double braking_s = std::min(t, 3.0);
    return Eigen::Vector3d(34.0 - 6.0 * braking_s + braking_s * braking_s, 1.0, 0.15);
  };
  ExpectRemoved(scene);
}

TEST(RemoveMovingObjects, KeepsEverythingOfAStreetWithoutTraffic) {
  Scene scene;
  scene.car_at = [](double) { return Eigen::Vector3d(500.0, 0.0, 0.15); };
  const Shares shares = Remove(scene);
  EXPECT_EQ(shares.num_car, 0);
  EXPECT_LT(shares.static_lost, 0.005);
  EXPECT_LT(shares.parked_lost, 0.01);
}

TEST(RemoveMovingObjects, LeavesOneScanAlone) {
  Scene scene;
  scene.num_scans = 1;
  scene.car_at = [](double) { return Eigen::Vector3d(12.0, 1.0, 0.15); };
  EXPECT_EQ(Remove(scene).car_removed, 0.0);
}

}  // namespace
}  // namespace scenecalib
