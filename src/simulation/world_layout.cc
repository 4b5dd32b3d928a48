#include "world_layout.h"

namespace scenecalib {

namespace {

constexpr double kRoadEdge = RoadLayout::kHalfWidthM;
constexpr double kKerbsideTree = kRoadEdge + 0.8;

/// A canyon of facades.
WorldLayout Street() {
  WorldLayout layout;
  layout.kind = "street";
  layout.corner_radius_m = 15.0;
  layout.sidewalk_end_m = 8.7;
  layout.ground_end_m = 9.6;
  layout.facade_m = 8.4;
  layout.house_length_m = 10.0;
  layout.house_height_m = {9.0, 15.0};
  layout.gap_share = 0.12;
  layout.gap_m = 4.5;
  layout.tree_every_m = 15.0;
  layout.tree_rows_m = {{kKerbsideTree, kKerbsideTree}};
  layout.lamp_every_m = 26.0;
  layout.sign_every_m = 17.0;
  layout.furniture_every_m = 8.0;
  layout.parked_share = 0.55;
  return layout;
}

/// Detached houses, gardens, hedges.
WorldLayout Suburb() {
  WorldLayout layout;
  layout.kind = "suburb";
  layout.corner_radius_m = 22.0;
  layout.sidewalk_end_m = 7.2;
  layout.ground_end_m = 26.0;
  layout.ground_material = Material::kGrass;
  layout.ground_albedo = {0.07F, 0.2F, 0.13F};
  layout.ground_roughness = 4.0;  // lawns are rougher than streets
  layout.facade_m = 12.5;
  layout.setback_m = {0.0, 2.5};
  layout.house_length_m = 11.0;
  layout.house_height_m = {5.2, 6.5};
  layout.house_depth_m = 7.0;
  layout.gap_share = 0.8;
  layout.gap_m = 6.0;
  layout.shop_share = 0.0;
  layout.detached = true;
  layout.edging = Edging::kGarden;
  layout.tree_every_m = 9.0;
  layout.tree_rows_m = {{8.8, 12.0}};
  layout.lamp_every_m = 34.0;
  layout.sign_every_m = 25.0;
  layout.furniture_every_m = 30.0;
  layout.furniture_offset_m = Range{kRoadEdge + 0.6, kRoadEdge + 0.6};
  layout.parked_share = 0.35;
  return layout;
}

/// A wide paved space with kiosks and columns.
WorldLayout Plaza() {
  WorldLayout layout;
  layout.kind = "plaza";
  layout.corner_radius_m = 30.0;
  layout.sidewalk_end_m = 20.3;
  layout.sidewalk_material = Material::kCobbles;
  layout.ground_end_m = 21.5;
  layout.facade_m = 20.0;
  layout.house_length_m = 14.0;
  layout.house_height_m = {11.0, 17.0};
  layout.gap_share = 0.1;
  layout.gap_m = 5.0;
  layout.tree_every_m = 13.0;
  layout.tree_rows_m = {{7.0, 17.0}};
  layout.lamp_every_m = 19.0;
  layout.sign_every_m = 30.0;
  layout.furniture_every_m = 6.0;
  layout.furniture_offset_m = Range{6.5, 18.0};
  layout.column_every_m = 7.0;
  layout.monument_every_m = 33.0;
  layout.kiosk_every_m = 29.0;
  layout.parked_share = 0.25;
  return layout;
}

/// Wide yards of concrete with containers and fences before large halls with plain walls; next to
/// no trees. Structure is far and has little texture, or one that repeats.
WorldLayout Industrial() {
  WorldLayout layout;
  layout.kind = "industrial";
  layout.corner_radius_m = 28.0;
  layout.sidewalk_end_m = 7.0;
  layout.ground_end_m = 34.0;
  layout.ground_material = Material::kStone;
  layout.ground_albedo = {0.27F, 0.28F, 0.29F};
  layout.facade_m = 29.0;
  layout.setback_m = {0.0, 4.0};
  layout.house_length_m = 32.0;
  layout.house_height_m = {7.5, 11.5};
  layout.house_depth_m = 22.0;
  layout.gap_share = 0.9;
  layout.gap_m = 10.0;
  layout.halls = true;
  layout.tree_every_m = 45.0;
  layout.tree_rows_m = {{9.0, 20.0}};
  layout.lamp_every_m = 31.0;
  layout.sign_every_m = 38.0;
  layout.furniture_every_m = 55.0;
  layout.container_every_m = 13.0;
  layout.fence_every_m = 40.0;
  layout.parked_share = 0.12;
  return layout;
}

/// A road between two rows of high trees on either side and parked cars; large houses far behind
/// them. Most of what is seen off the road is leaves and trunks.
WorldLayout Avenue() {
  WorldLayout layout;
  layout.kind = "avenue";
  layout.corner_radius_m = 24.0;
  layout.sidewalk_end_m = 9.6;
  layout.ground_end_m = 27.0;
  layout.ground_material = Material::kGrass;
  layout.ground_albedo = {0.07F, 0.19F, 0.12F};
  layout.ground_roughness = 3.0;
  layout.facade_m = 25.0;
  layout.setback_m = {0.0, 1.5};
  layout.house_length_m = 19.0;
  layout.house_height_m = {12.0, 18.0};
  layout.house_depth_m = 11.0;
  layout.gap_share = 0.5;
  layout.gap_m = 8.0;
  layout.shop_share = 0.1;
  layout.tree_every_m = 6.0;
  layout.tree_rows_m = {{6.4, 6.9}, {10.6, 12.4}};
  layout.tree_height_m = {7.5, 11.5};
  layout.leaves_per_cluster = 280;
  layout.lamp_every_m = 24.0;
  layout.sign_every_m = 26.0;
  layout.furniture_every_m = 15.0;
  layout.parked_share = 0.85;
  return layout;
}

/// A narrow road without parking between low gabled houses, some at its very edge and some behind
/// walls of stone and gardens.
WorldLayout Village() {
  WorldLayout layout;
  layout.kind = "village";
  layout.corner_radius_m = 13.0;
  layout.road_half_width_m = 3.7;
  layout.sidewalk_end_m = 5.3;
  layout.sidewalk_material = Material::kCobbles;
  layout.ground_end_m = 18.0;
  layout.ground_material = Material::kGrass;
  layout.ground_albedo = {0.08F, 0.21F, 0.14F};
  layout.ground_roughness = 5.0;
  layout.facade_m = 5.5;
  layout.setback_m = {0.0, 5.5};
  layout.house_length_m = 9.0;
  layout.house_height_m = {3.2, 5.4};
  layout.house_depth_m = 7.0;
  layout.gap_share = 0.55;
  layout.gap_m = 6.0;
  layout.shop_share = 0.0;
  layout.detached = true;
  layout.edging = Edging::kStoneWall;
  layout.tree_every_m = 12.0;
  layout.tree_rows_m = {{7.0, 12.0}};
  layout.tree_height_m = {3.5, 7.0};
  layout.lamp_every_m = 37.0;
  layout.sign_every_m = 31.0;
  layout.furniture_every_m = 19.0;
  return layout;
}

}  // namespace

const std::vector<WorldLayout>& WorldLayouts() {
  static const std::vector<WorldLayout> kLayouts = {Street(),     Suburb(), Plaza(),
                                                    Industrial(), Avenue(), Village()};
  return kLayouts;
}

const WorldLayout* FindWorldLayout(const std::string& kind) {
  for (const WorldLayout& layout : WorldLayouts()) {
    if (layout.kind == kind) return &layout;
  }
  return nullptr;
}

}  // namespace scenecalib
