// The ground in strips along the road, from its middle outwards: asphalt, kerbs, pavements, and
// what lies between them and the buildings.

#include "world_draft.h"

namespace scenecalib {

namespace {

constexpr double kKerbWidthM = 0.15;
constexpr double kFineStepM = 0.6;
constexpr double kCoarseStepM = 1.2;

void AddStrip(const std::vector<double>& offsets, double step_m, std::uint32_t surface,
              WorldDraft* draft) {
  const RoadCurve& road = draft->road();
  const int rows = static_cast<int>((road.end_s_m() - road.start_s_m()) / step_m);
  for (int row = 0; row < rows; ++row) {
    const double s0 = road.start_s_m() + row * step_m;
    const double s1 = s0 + step_m;
    for (std::size_t i = 0; i + 1 < offsets.size(); ++i) {
      const double d0 = offsets[i];
      const double d1 = offsets[i + 1];
      draft->world().mesh.AddQuad(draft->Ground(s0, d0, 0.0), draft->Ground(s1, d0, 0.0),
                                  draft->Ground(s1, d1, 0.0), draft->Ground(s0, d1, 0.0), {s0, d0},
                                  {s1, d0}, {s1, d1}, {s0, d1}, surface);
    }
  }
}

std::vector<double> Offsets(double from, double to, double step) {
  const int n = std::max(1, static_cast<int>(std::ceil(std::abs(to - from) / step)));
  std::vector<double> offsets;
  for (int i = 0; i <= n; ++i) offsets.push_back(from + (to - from) * i / n);
  return offsets;
}

/// The kerb's upright face, from the road's edge up.
void AddKerbFace(double side, std::uint32_t surface, WorldDraft* draft) {
  const RoadCurve& road = draft->road();
  const double d = side * draft->layout().road_half_width_m;
  const double kerb_m = draft->kerb_m();
  const int rows = static_cast<int>((road.end_s_m() - road.start_s_m()) / kFineStepM);
  for (int row = 0; row < rows; ++row) {
    const double s0 = road.start_s_m() + row * kFineStepM;
    const double s1 = s0 + kFineStepM;
    draft->world().mesh.AddQuad(draft->Ground(s0, d, 0.0), draft->Ground(s1, d, 0.0),
                                draft->Ground(s1, d, kerb_m), draft->Ground(s0, d, kerb_m),
                                {s0, 50.0}, {s1, 50.0}, {s1, 50.0 + kerb_m}, {s0, 50.0 + kerb_m},
                                surface);
  }
}

/// A plain below everything, so that no ray falls out of the world between houses.
void AddFarGround(WorldDraft* draft) {
  const RoadCurve& road = draft->road();
  Eigen::Vector3d low = road.Point(road.start_s_m(), 0.0, 0.0);
  Eigen::Vector3d high = low;
  for (double s = road.start_s_m(); s < road.end_s_m(); s += 5.0) {
    low = low.cwiseMin(road.Point(s, 0.0, 0.0));
    high = high.cwiseMax(road.Point(s, 0.0, 0.0));
  }
  const double margin_m = 150.0;
  const Eigen::Vector3d corner(low.x() - margin_m, low.y() - margin_m, low.z() - 0.9);
  const Eigen::Vector3d size = high - low + Eigen::Vector3d(2 * margin_m, 2 * margin_m, 0.0);
  draft->world().mesh.AddPatch(corner, {size.x(), 0.0, 0.0}, {0.0, size.y(), 0.0}, {0.0, 0.0},
                               draft->NewSurface(Material::kGrass, {0.07F, 0.17F, 0.13F}));
}

}  // namespace

void AddGround(WorldDraft* draft) {
  const WorldLayout& layout = draft->layout();
  const double half = layout.road_half_width_m;
  const float asphalt = static_cast<float>(draft->random().Uniform(0.8, 1.4));
  AddStrip(Offsets(-half, half, kFineStepM), kFineStepM,
           draft->NewSurface(Material::kAsphalt, Eigen::Vector3f(0.115F, 0.11F, 0.107F) * asphalt),
           draft);
  const Eigen::Vector3f stone = Eigen::Vector3f(0.3F, 0.32F, 0.33F);
  for (const double side : {-1.0, 1.0}) {
    const std::uint32_t kerb = draft->NewSurface(Material::kStone, 1.2F * stone);
    AddKerbFace(side, kerb, draft);
    AddStrip({side * (half + 1e-5), side * (half + kKerbWidthM)}, kFineStepM, kerb, draft);
    const std::uint32_t walk = draft->NewSurface(layout.sidewalk_material, stone);
    AddStrip(Offsets(side * (half + kKerbWidthM), side * layout.sidewalk_end_m, kCoarseStepM),
             kCoarseStepM, walk, draft);
    if (layout.ground_end_m > layout.sidewalk_end_m) {
      const std::uint32_t rest = draft->NewSurface(layout.ground_material, layout.ground_albedo);
      AddStrip(Offsets(side * layout.sidewalk_end_m, side * layout.ground_end_m, kCoarseStepM),
               kCoarseStepM, rest, draft);
    }
  }
  AddFarGround(draft);
}

}  // namespace scenecalib
