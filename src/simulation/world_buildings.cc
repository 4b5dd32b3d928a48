// What closes the view to both sides: houses or halls in a row, with their hedges and walls.

#include <Eigen/Geometry>

#include "scenecalib/simulation/buildings.h"
#include "scenecalib/simulation/yard.h"
#include "world_draft.h"

namespace scenecalib {

namespace {

Rigid3 Upright(double heading_rad, const Eigen::Vector3d& origin_m) {
  return {Eigen::Quaterniond(Eigen::AngleAxisd(heading_rad, Eigen::Vector3d::UnitZ())), origin_m};
}

constexpr double kEdgeFoundationM = 0.3;  // a hedge or a wall reaches so far into the ground

/// A box of about a metre's length along the road from s, at offset d.
void AddEdgePiece(double s, double d, double width_m, double total_height_m, std::uint32_t surface,
                  WorldDraft* draft) {
  const RoadCurve& road = draft->road();
  const double length_m = (1.0 - road.Curvature(s) * d) + 0.05;
  if (length_m < 0.1) return;
  draft->world().mesh.AddBox(Upright(road.Heading(s + 0.5), draft->Ground(s, d, -kEdgeFoundationM)),
                             {length_m, width_m, total_height_m}, surface);
}

/// A hedge or a wall between garden and pavement, in pieces of different height.
void AddGardenEdge(double side, double s0, double s1, WorldDraft* draft) {
  Random& random = draft->random();
  const bool hedge = random.Uniform() < 0.6;
  const std::uint32_t surface = hedge ? draft->NewSurface(Material::kGrass, {0.05F, 0.16F, 0.09F})
                                      : draft->NewSurface(Material::kBrick, {0.14F, 0.18F, 0.34F});
  const double height = hedge ? random.Uniform(0.8, 1.5) : random.Uniform(0.5, 1.0);
  const double gate = random.Uniform(s0 + 1.0, s1 - 1.0);
  for (double s = s0; s < s1; s += 1.0) {
    if (std::abs(s + 0.5 - gate) < 1.2) continue;
    const double jitter = hedge ? random.Uniform(-0.12, 0.12) : 0.0;
    const double d = side * (draft->layout().sidewalk_end_m + 0.5 + jitter);
    AddEdgePiece(s, d, hedge ? 0.6 : 0.24, height + kEdgeFoundationM + jitter, surface, draft);
  }
}

/// A wall of rough stone at the pavement's edge, with a gate; its top is as uneven as old walls'.
void AddStoneWall(double side, double s0, double s1, WorldDraft* draft) {
  Random& random = draft->random();
  const std::uint32_t surface =
      draft->NewSurface(Material::kFieldStone, Eigen::Vector3f(0.3F, 0.34F, 0.37F) *
                                                   static_cast<float>(random.Uniform(0.7, 1.2)));
  const double height = random.Uniform(0.7, 1.5);
  const double gate = random.Uniform(s0 + 1.0, std::max(s0 + 1.5, s1 - 1.0));
  for (double s = s0; s < s1; s += 1.0) {
    if (std::abs(s + 0.5 - gate) < 1.0) continue;
    const double d = side * (draft->layout().sidewalk_end_m + 0.2);
    AddEdgePiece(s, d, 0.35, height + kEdgeFoundationM + random.Uniform(-0.06, 0.06), surface,
                 draft);
  }
}

void AddHallAt(double s0, double d0, double s1, double d1, double depth_m, double height_m,
               WorldDraft* draft) {
  HallSpec spec;
  spec.front_left_m = draft->Ground(s0, d0, 0.0);
  spec.front_right_m = draft->Ground(s1, d1, 0.0);
  const double base = std::min(spec.front_left_m.z(), spec.front_right_m.z());
  spec.front_left_m.z() = base;
  spec.front_right_m.z() = base;
  if ((spec.front_right_m - spec.front_left_m).norm() < 6.0) return;
  spec.depth_m = depth_m;
  spec.height_m = height_m;
  spec.object_id = draft->NextObject();
  AddHall(spec, draft->NextRandom(), &draft->world().mesh);
}

/// One building of the row, from s to s + length.
void AddBuilding(double side, double s, double length, double setback, double height, bool shop,
                 WorldDraft* draft) {
  const WorldLayout& layout = draft->layout();
  const double d = side * (layout.facade_m + setback);
  const double s_left = side > 0.0 ? s : s + length;
  const double s_right = side > 0.0 ? s + length : s;
  if (!draft->HasRoom(s + 0.5 * length, d)) return;
  if (layout.halls) {
    AddHallAt(s_left, d, s_right, d, layout.house_depth_m, height, draft);
  } else {
    AddHouseAt(s_left, d, s_right, d, layout.house_depth_m, height, shop, layout.detached, draft);
  }
  draft->AddFootprint(s, s + length, d, d + side * layout.house_depth_m);
  if (layout.edging == Edging::kGarden) AddGardenEdge(side, s, s + length, draft);
  if (layout.edging == Edging::kStoneWall && setback > 1.2) {
    AddStoneWall(side, s, s + length, draft);
  }
}

}  // namespace

void AddHouseAt(double s0, double d0, double s1, double d1, double depth_m, double height_m,
                bool shop, bool detached, WorldDraft* draft) {
  HouseSpec spec;
  spec.front_left_m = draft->Ground(s0, d0, 0.0);
  spec.front_right_m = draft->Ground(s1, d1, 0.0);
  const double base = std::min(spec.front_left_m.z(), spec.front_right_m.z());
  spec.front_left_m.z() = base;
  spec.front_right_m.z() = base;
  if ((spec.front_right_m - spec.front_left_m).norm() < 1.5) return;
  spec.depth_m = depth_m;
  spec.height_m = height_m;
  spec.shop = shop;
  spec.gabled = detached;
  spec.windows_on_all_sides = detached;
  spec.object_id = draft->NextObject();
  AddHouse(spec, draft->NextRandom(), &draft->world().mesh);
}

void AddBuildings(double side, WorldDraft* draft) {
  const WorldLayout& layout = draft->layout();
  const RoadCurve& road = draft->road();
  Random& random = draft->random();
  double s = road.start_s_m() + 1.0;
  while (s + 4.0 < road.end_s_m()) {
    double length = layout.house_length_m * random.Uniform(0.75, 1.3);
    // In a bend houses are shorter, so that their straight fronts follow it.
    while (std::abs(road.Heading(s + length) - road.Heading(s)) > 0.35 && length > 2.5) {
      length *= 0.8;
    }
    const double setback = draft->Draw(layout.setback_m);
    const double height = draft->Draw(layout.house_height_m);
    const bool shop = layout.shop_share > 0.0 && random.Uniform() < layout.shop_share;
    AddBuilding(side, s, length, setback, height, shop, draft);
    s += length;
    if (random.Uniform() < layout.gap_share) s += layout.gap_m * random.Uniform(0.7, 1.3);
  }
}

void AddEnds(WorldDraft* draft) {
  for (int i = 0; i < 3; ++i) {
    const double d0 = 15.0 - 10.0 * i;
    const double s_end = draft->road().end_s_m() - 0.5;
    const double s_start = draft->road().start_s_m() + 0.5;
    const double height =
        std::max(draft->layout().house_height_m.high, 9.0) * draft->random().Uniform(0.8, 1.1);
    AddHouseAt(s_end, d0, s_end, d0 - 10.0, 8.0, height, true, false, draft);
    AddHouseAt(s_start, d0 - 10.0, s_start, d0, 8.0, height, true, false, draft);
  }
}

}  // namespace scenecalib
