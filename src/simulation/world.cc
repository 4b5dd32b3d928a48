// How a world is put together, from the road outwards: ground strips (road, kerb, pavement, lawn),
// then what stands along each side, then cars. Positions are arc length s and offset d to the left.

#include "scenecalib/simulation/world.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>

#include "scenecalib/simulation/buildings.h"
#include "scenecalib/simulation/props.h"
#include "scenecalib/simulation/texture.h"

namespace scenecalib {

namespace {

constexpr double kKerbWidth = 0.15;  // metres

/// What differs between the kinds of world.
struct Layout {
  double sidewalk_end_m;  ///< offset where the pavement ends
  double facade_m;        ///< offset of the houses' fronts
  double ground_end_m;    ///< offset where the last strip ends, behind the fronts
  double house_length_m, gap_share, gap_m;
  double height_low_m, height_high_m;
  double tree_every_m, lamp_every_m, sign_every_m, furniture_every_m;
  double parked_share;
};

Layout LayoutOf(const std::string& kind) {
  if (kind == "suburb") {
    return {7.2, 12.5, 26.0, 11.0, 0.8, 6.0, 5.2, 6.5, 9.0, 34.0, 25.0, 30.0, 0.35};
  }
  if (kind == "plaza") {
    return {20.3, 20.0, 21.5, 14.0, 0.1, 5.0, 11.0, 17.0, 13.0, 19.0, 30.0, 6.0, 0.25};
  }
  return {8.7, 8.4, 9.6, 10.0, 0.12, 4.5, 9.0, 15.0, 15.0, 26.0, 17.0, 8.0, 0.55};
}

class WorldBuilder {
 public:
  WorldBuilder(const SimulatedWorldOptions& options, const RoadCurve& road, Random random)
      : options_(options), road_(road), random_(random), layout_(LayoutOf(options.kind)) {
    kerb_m_ = random_.Uniform(0.1, 0.15);
    const double azimuth = random_.Uniform(0.0, 2.0 * M_PI);
    const double elevation = random_.Uniform(0.65, 1.05);
    world_.towards_sun = {std::cos(elevation) * std::cos(azimuth),
                          std::cos(elevation) * std::sin(azimuth), std::sin(elevation)};
  }

  World Build(double mean_speed_m_s) {
    AddGround();
    for (const double side : {-1.0, 1.0}) {
      AddHouses(side);
      AddAlong(side);
      AddParkedCars(side);
    }
    AddEnds();
    AddMovingCars(mean_speed_m_s);
    return std::move(world_);
  }

 private:
  std::uint32_t NextObject() { return next_object_++; }

  Random NextRandom() { return random_.Fork(random_.NextBits()); }

  std::uint32_t NewSurface(Material material, const Eigen::Vector3f& albedo) {
    Surface surface;
    surface.material = material;
    surface.albedo = albedo;
    surface.seed = static_cast<std::uint32_t>(random_.NextBits());
    surface.object_id = NextObject();
    return world_.mesh.AddSurface(surface);
  }

  /// Height of the ground above the hills at an offset.
  double GroundHeight(double s, double d) const {
    const double half = RoadLayout::kHalfWidthM;
    const double side = std::abs(d);
    const double crown = -0.0025 * std::min(side, half) * std::min(side, half);
    double height = crown + road_.BumpHeight(s, d);
    if (side > half + 1e-6) height += kerb_m_ + 0.015 * (side - half);
    if (side > layout_.sidewalk_end_m && options_.kind == "suburb") {
      // Lawns are rougher than streets.
      height += 4.0 * road_.BumpHeight(1.3 * s + 500.0, 1.3 * d);
    }
    return height;
  }

  /// A point on the ground (plus height), not past the centre of a bend.
  Eigen::Vector3d Ground(double s, double d, double above_m) const {
    const double curvature = road_.Curvature(s);
    double clamped = d;
    if (curvature * d > 0.85) clamped = 0.85 / curvature;
    return road_.Point(s, clamped, GroundHeight(s, d) + above_m);
  }

  bool HasRoom(double s, double d) const { return road_.Curvature(s) * d < 0.6; }

  void AddStrip(const std::vector<double>& offsets, double step_m, std::uint32_t surface) {
    const int rows = static_cast<int>((road_.end_s_m() - road_.start_s_m()) / step_m);
    for (int row = 0; row < rows; ++row) {
      const double s0 = road_.start_s_m() + row * step_m;
      const double s1 = s0 + step_m;
      for (std::size_t i = 0; i + 1 < offsets.size(); ++i) {
        const double d0 = offsets[i];
        const double d1 = offsets[i + 1];
        world_.mesh.AddQuad(Ground(s0, d0, 0.0), Ground(s1, d0, 0.0), Ground(s1, d1, 0.0),
                            Ground(s0, d1, 0.0), {s0, d0}, {s1, d0}, {s1, d1}, {s0, d1}, surface);
      }
    }
  }

  static std::vector<double> Offsets(double from, double to, double step) {
    const int n = std::max(1, static_cast<int>(std::ceil(std::abs(to - from) / step)));
    std::vector<double> offsets;
    for (int i = 0; i <= n; ++i) offsets.push_back(from + (to - from) * i / n);
    return offsets;
  }

  void AddGround() {
    const double half = RoadLayout::kHalfWidthM;
    AddStrip(Offsets(-half, half, 0.6), 0.6,
             NewSurface(Material::kAsphalt, Eigen::Vector3f(0.115F, 0.11F, 0.107F) *
                                                static_cast<float>(random_.Uniform(0.8, 1.4))));
    const bool plaza = options_.kind == "plaza";
    const Eigen::Vector3f stone = Eigen::Vector3f(0.3F, 0.32F, 0.33F);
    for (const double side : {-1.0, 1.0}) {
      const std::uint32_t kerb = NewSurface(Material::kStone, 1.2F * stone);
      AddKerbFace(side, kerb);
      AddStrip({side * (half + 1e-5), side * (half + kKerbWidth)}, 0.6, kerb);
      const std::uint32_t walk = NewSurface(plaza ? Material::kCobbles : Material::kPaving, stone);
      AddStrip(Offsets(side * (half + kKerbWidth), side * layout_.sidewalk_end_m, 1.2), 1.2, walk);
      if (layout_.ground_end_m > layout_.sidewalk_end_m) {
        const bool lawn = options_.kind == "suburb";
        const std::uint32_t rest = NewSurface(lawn ? Material::kGrass : Material::kPaving,
                                              lawn ? Eigen::Vector3f(0.07F, 0.2F, 0.13F) : stone);
        AddStrip(Offsets(side * layout_.sidewalk_end_m, side * layout_.ground_end_m, 1.2), 1.2,
                 rest);
      }
    }
    AddFarGround();
  }

  /// The kerb's upright face, from the road's edge up.
  void AddKerbFace(double side, std::uint32_t surface) {
    const double d = side * RoadLayout::kHalfWidthM;
    const double step_m = 0.6;
    const int rows = static_cast<int>((road_.end_s_m() - road_.start_s_m()) / step_m);
    for (int row = 0; row < rows; ++row) {
      const double s0 = road_.start_s_m() + row * step_m;
      const double s1 = s0 + step_m;
      world_.mesh.AddQuad(Ground(s0, d, 0.0), Ground(s1, d, 0.0), Ground(s1, d, kerb_m_),
                          Ground(s0, d, kerb_m_), {s0, 50.0}, {s1, 50.0}, {s1, 50.0 + kerb_m_},
                          {s0, 50.0 + kerb_m_}, surface);
    }
  }

  /// A plain below everything, so that no ray falls out of the world between houses.
  void AddFarGround() {
    Eigen::Vector3d low = road_.Point(road_.start_s_m(), 0.0, 0.0);
    Eigen::Vector3d high = low;
    for (double s = road_.start_s_m(); s < road_.end_s_m(); s += 5.0) {
      low = low.cwiseMin(road_.Point(s, 0.0, 0.0));
      high = high.cwiseMax(road_.Point(s, 0.0, 0.0));
    }
    const double margin_m = 150.0;
    const Eigen::Vector3d corner(low.x() - margin_m, low.y() - margin_m, low.z() - 0.9);
    const Eigen::Vector3d size = high - low + Eigen::Vector3d(2 * margin_m, 2 * margin_m, 0.0);
    world_.mesh.AddPatch(corner, {size.x(), 0.0, 0.0}, {0.0, size.y(), 0.0}, {0.0, 0.0},
                         NewSurface(Material::kGrass, {0.07F, 0.17F, 0.13F}));
  }

  /// A house whose front runs from (s0, d0) to (s1, d1).
  void AddHouseAt(double s0, double d0, double s1, double d1, double depth_m, double height_m,
                  bool shop, bool detached) {
    HouseSpec spec;
    spec.front_left_m = Ground(s0, d0, 0.0);
    spec.front_right_m = Ground(s1, d1, 0.0);
    const double base = std::min(spec.front_left_m.z(), spec.front_right_m.z());
    spec.front_left_m.z() = base;
    spec.front_right_m.z() = base;
    if ((spec.front_right_m - spec.front_left_m).norm() < 1.5) return;
    spec.depth_m = depth_m;
    spec.height_m = height_m;
    spec.shop = shop;
    spec.gabled = detached;
    spec.windows_on_all_sides = detached;
    spec.object_id = NextObject();
    AddHouse(spec, NextRandom(), &world_.mesh);
  }

  void AddHouses(double side) {
    const bool suburb = options_.kind == "suburb";
    double s = road_.start_s_m() + 1.0;
    while (s + 4.0 < road_.end_s_m()) {
      double length = layout_.house_length_m * random_.Uniform(0.75, 1.3);
      // In a bend houses are shorter, so that their straight fronts follow it.
      while (std::abs(road_.Heading(s + length) - road_.Heading(s)) > 0.35 && length > 2.5) {
        length *= 0.8;
      }
      const double setback = suburb ? random_.Uniform(0.0, 2.5) : random_.Uniform(0.0, 0.45);
      const double d = side * (layout_.facade_m + setback);
      const double height = random_.Uniform(layout_.height_low_m, layout_.height_high_m);
      const double s_left = side > 0.0 ? s : s + length;
      const double s_right = side > 0.0 ? s + length : s;
      const bool shop = !suburb && random_.Uniform() < 0.45;
      if (HasRoom(s + 0.5 * length, d)) {
        AddHouseAt(s_left, d, s_right, d, suburb ? 7.0 : 8.0, height, shop, suburb);
        if (suburb) AddGardenEdge(side, s, s + length);
      }
      s += length;
      if (random_.Uniform() < layout_.gap_share) s += layout_.gap_m * random_.Uniform(0.7, 1.3);
    }
  }

  /// A hedge or a wall between garden and pavement, in pieces of different height.
  void AddGardenEdge(double side, double s0, double s1) {
    const bool hedge = random_.Uniform() < 0.6;
    const std::uint32_t surface = hedge ? NewSurface(Material::kGrass, {0.05F, 0.16F, 0.09F})
                                        : NewSurface(Material::kBrick, {0.14F, 0.18F, 0.34F});
    const double height = hedge ? random_.Uniform(0.8, 1.5) : random_.Uniform(0.5, 1.0);
    const double gate = random_.Uniform(s0 + 1.0, s1 - 1.0);
    for (double s = s0; s < s1; s += 1.0) {
      if (std::abs(s + 0.5 - gate) < 1.2) continue;
      const double jitter = hedge ? random_.Uniform(-0.12, 0.12) : 0.0;
      const double d = side * (layout_.sidewalk_end_m + 0.5 + jitter);
      const Eigen::Vector3d a = Ground(s, d, -0.3);
      const Rigid3 frame(
          Eigen::Quaterniond(Eigen::AngleAxisd(road_.Heading(s + 0.5), Eigen::Vector3d::UnitZ())),
          a);
      const double length = (1.0 - road_.Curvature(s) * d) + 0.05;
      if (length < 0.1) continue;
      world_.mesh.AddBox(frame, {length, hedge ? 0.6 : 0.24, height + 0.3 + jitter}, surface);
    }
  }

  /// Calls add(s) about every `every_m` metres.
  template <typename Add>
  void Every(double every_m, const Add& add) {
    double s = road_.start_s_m() + random_.Uniform(0.0, every_m);
    while (s < road_.end_s_m() - 2.0) {
      add(s);
      s += every_m * random_.Uniform(0.7, 1.3);
    }
  }

  void AddAlong(double side) {
    Mesh* mesh = &world_.mesh;
    const double half = RoadLayout::kHalfWidthM;
    const bool plaza = options_.kind == "plaza";
    const bool suburb = options_.kind == "suburb";
    Every(layout_.tree_every_m, [&](double s) {
      double d = side * (half + 0.8);
      if (suburb) d = side * random_.Uniform(8.8, 12.0);
      if (plaza) d = side * random_.Uniform(7.0, 17.0);
      if (!HasRoom(s, d)) return;
      AddTree(Ground(s, d, 0.0), random_.Uniform(4.5, 8.0), NextObject(), NextRandom(), mesh,
              &world_.shadow_mesh);
    });
    Every(layout_.lamp_every_m, [&](double s) {
      AddLamp(Ground(s, side * (half + 0.5), 0.0), -side * road_.Left(s), NextObject(),
              NextRandom(), mesh);
    });
    Every(layout_.sign_every_m, [&](double s) {
      // Signs face those who drive on their side.
      AddSignPost(Ground(s, side * (half + 0.4), 0.0), side * road_.Along(s), NextObject(),
                  NextRandom(), mesh);
    });
    Every(layout_.furniture_every_m, [&](double s) {
      double d = side * (layout_.sidewalk_end_m - random_.Uniform(0.6, 1.2));
      if (plaza) d = side * random_.Uniform(6.5, 18.0);
      if (suburb) d = side * (half + 0.6);
      AddFurniture(Ground(s, d, 0.0), road_.Heading(s) + random_.Uniform(-0.2, 0.2), NextObject(),
                   NextRandom(), mesh);
    });
    if (!plaza) return;
    Every(7.0, [&](double s) {
      AddColumn(Ground(s, side * 18.7, 0.0), random_.Uniform(4.0, 4.6), NextObject(), NextRandom(),
                mesh);
    });
    Every(33.0, [&](double s) {
      AddMonument(Ground(s, side * random_.Uniform(10.0, 15.0), 0.0), NextObject(), NextRandom(),
                  mesh);
    });
    Every(29.0, [&](double s) {  // kiosks
      const double d = side * random_.Uniform(9.0, 13.0);
      const double s_left = side > 0.0 ? s : s + 4.0;
      const double s_right = side > 0.0 ? s + 4.0 : s;
      AddHouseAt(s_left, d, s_right, d, 3.0, 3.0, true, true);
    });
  }

  void AddParkedCars(double side) {
    Every(6.2, [&](double s) {
      if (random_.Uniform() > layout_.parked_share) return;
      const double d = side * (RoadLayout::kLaneM + 1.0 + random_.Uniform(-0.1, 0.1));
      const double turned = random_.Uniform() < 0.15 ? M_PI : 0.0;
      const double heading =
          road_.Heading(s) + (side > 0.0 ? M_PI : 0.0) + turned + random_.Uniform(-0.04, 0.04);
      const Rigid3 map_from_car(
          Eigen::Quaterniond(Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ())),
          Ground(s, d, -0.01));
      AddCar(map_from_car, NextObject(), NextRandom(), &world_.mesh);
    });
  }

  /// Houses across both ends of the road.
  void AddEnds() {
    for (int i = 0; i < 3; ++i) {
      const double d0 = 15.0 - 10.0 * i;
      const double s_end = road_.end_s_m() - 0.5;
      const double s_start = road_.start_s_m() + 0.5;
      const double height = std::max(layout_.height_high_m, 9.0) * random_.Uniform(0.8, 1.1);
      AddHouseAt(s_end, d0, s_end, d0 - 10.0, 8.0, height, true, false);
      AddHouseAt(s_start, d0 - 10.0, s_start, d0, 8.0, height, true, false);
    }
  }

  void AddMovingCars(double mean_speed_m_s) {
    for (int i = 0; i < options_.num_moving_cars; ++i) {
      MovingCar car;
      car.oncoming = i % 3 != 1;
      car.phase_rad = random_.Uniform(0.0, 2.0 * M_PI);
      car.speed_m_s = mean_speed_m_s * random_.Uniform(0.7, 1.0);
      car.offset_m =
          car.oncoming ? 25.0 + 22.0 * i + random_.Uniform(0.0, 15.0) : 16.0 + 9.0 * (i / 3);
      AddCar(Rigid3(), NextObject(), NextRandom(), &car.mesh);
      world_.cars.push_back(std::move(car));
    }
  }

  const SimulatedWorldOptions options_;
  const RoadCurve& road_;
  Random random_;
  const Layout layout_;
  double kerb_m_ = 0.12;
  std::uint32_t next_object_ = 1;
  World world_;
};

}  // namespace

double CornerRadius(const std::string& world_kind) {
  if (world_kind == "plaza") return 30.0;
  if (world_kind == "suburb") return 22.0;
  return 15.0;
}

World BuildWorld(const SimulatedWorldOptions& options, const RoadCurve& road, double mean_speed_m_s,
                 Random random) {
  return WorldBuilder(options, road, random).Build(mean_speed_m_s);
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
