// What stands along the road. Random numbers are drawn into variables first, the generator of a
// thing before its numbers: the order of a call's arguments is the compiler's.

#include "scenecalib/simulation/props.h"
#include "scenecalib/simulation/yard.h"
#include "world_draft.h"

namespace scenecalib {

namespace {

void AddTrees(double side, WorldDraft* draft) {
  const WorldLayout& layout = draft->layout();
  for (const Range& row : layout.tree_rows_m) {
    draft->Every(layout.tree_every_m, [&](double s) {
      const double d = side * draft->Draw(row);
      if (!draft->HasRoom(s, d) || draft->IsBuiltOn(s, d, 0.8)) return;
      const Random random = draft->NextRandom();
      const double height_m = draft->Draw(layout.tree_height_m);
      AddTree(draft->Ground(s, d, 0.0), height_m, layout.leaves_per_cluster, draft->NextObject(),
              random, &draft->world().mesh, &draft->world().shadow_mesh);
    });
  }
}

void AddKerbside(double side, WorldDraft* draft) {
  const WorldLayout& layout = draft->layout();
  const RoadCurve& road = draft->road();
  const double half = layout.road_half_width_m;
  Mesh* mesh = &draft->world().mesh;
  draft->Every(layout.lamp_every_m, [&](double s) {
    AddLamp(draft->Ground(s, side * (half + 0.5), 0.0), -side * road.Left(s), draft->NextObject(),
            draft->NextRandom(), mesh);
  });
  draft->Every(layout.sign_every_m, [&](double s) {
    // Signs face those who drive on their side.
    AddSignPost(draft->Ground(s, side * (half + 0.4), 0.0), side * road.Along(s),
                draft->NextObject(), draft->NextRandom(), mesh);
  });
  draft->Every(layout.furniture_every_m, [&](double s) {
    double d = side * (layout.sidewalk_end_m - draft->random().Uniform(0.6, 1.2));
    if (layout.furniture_offset_m) d = side * draft->Draw(*layout.furniture_offset_m);
    const Random random = draft->NextRandom();
    const double heading_rad = road.Heading(s) + draft->random().Uniform(-0.2, 0.2);
    AddFurniture(draft->Ground(s, d, 0.0), heading_rad, draft->NextObject(), random, mesh);
  });
}

/// Columns before the houses, monuments and kiosks.
void AddPlazaThings(double side, WorldDraft* draft) {
  const WorldLayout& layout = draft->layout();
  Mesh* mesh = &draft->world().mesh;
  draft->Every(layout.column_every_m, [&](double s) {
    const Random random = draft->NextRandom();
    const double height_m = draft->random().Uniform(4.0, 4.6);
    AddColumn(draft->Ground(s, side * 18.7, 0.0), height_m, draft->NextObject(), random, mesh);
  });
  draft->Every(layout.monument_every_m, [&](double s) {
    const Random random = draft->NextRandom();
    const double d = side * draft->random().Uniform(10.0, 15.0);
    AddMonument(draft->Ground(s, d, 0.0), draft->NextObject(), random, mesh);
  });
  draft->Every(layout.kiosk_every_m, [&](double s) {
    const double d = side * draft->random().Uniform(9.0, 13.0);
    const double s_left = side > 0.0 ? s : s + 4.0;
    const double s_right = side > 0.0 ? s + 4.0 : s;
    AddHouseAt(s_left, d, s_right, d, 3.0, 3.0, true, true, draft);
  });
}

/// Containers in the yards, and fences between yards and pavement.
void AddYardThings(double side, WorldDraft* draft) {
  const WorldLayout& layout = draft->layout();
  const RoadCurve& road = draft->road();
  Mesh* mesh = &draft->world().mesh;
  draft->Every(layout.container_every_m, [&](double s) {
    const Random random = draft->NextRandom();
    const double d = side * draft->random().Uniform(11.0, 24.0);
    const double across = draft->random().Uniform() < 0.3 ? 0.5 * M_PI : 0.0;
    const double heading_rad = road.Heading(s) + across + draft->random().Uniform(-0.08, 0.08);
    if (!draft->HasRoom(s, d)) return;
    AddContainers(draft->Ground(s, d, 0.0), heading_rad, draft->NextObject(), random, mesh);
  });
  draft->Every(layout.fence_every_m, [&](double s) {
    const double length_m = draft->random().Uniform(0.35, 0.65) * layout.fence_every_m;
    const double d = side * (layout.sidewalk_end_m + 0.5);
    std::vector<Eigen::Vector3d> posts_m;
    for (double at = s; at < std::min(s + length_m, road.end_s_m()); at += 2.4) {
      posts_m.push_back(draft->Ground(at, d, 0.0));
    }
    AddFence(posts_m, draft->NextObject(), draft->NextRandom(), mesh);
  });
}

}  // namespace

void AddAlong(double side, WorldDraft* draft) {
  AddTrees(side, draft);
  AddKerbside(side, draft);
  AddPlazaThings(side, draft);
  AddYardThings(side, draft);
}

}  // namespace scenecalib
