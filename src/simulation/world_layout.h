#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scenecalib/simulation/mesh.h"
#include "scenecalib/simulation/texture.h"

namespace scenecalib {

/// A range to draw from; one value where both ends are the same.
struct Range {
  double low = 0.0;
  double high = 0.0;
};

/// What stands between the pavement and the buildings' grounds.
enum class Edging { kNone, kGarden, kStoneWall };

/// What differs between the kinds of world. Offsets are metres from the road's centreline to either
/// side; `..._every_m` are mean distances along it, none for 0.
struct WorldLayout {
  std::string kind;
  double corner_radius_m = 15.0;  ///< the sharpest corner that there is room for

  // The ground, from the road outwards.
  double road_half_width_m = RoadLayout::kHalfWidthM;
  double sidewalk_end_m = 0.0;
  double ground_end_m = 0.0;  ///< where the last strip ends, behind the buildings' fronts
  Material sidewalk_material = Material::kPaving;
  Material ground_material = Material::kPaving;
  Eigen::Vector3f ground_albedo = Eigen::Vector3f(0.3F, 0.32F, 0.33F);
  double ground_roughness = 0.0;  ///< times the road's own, beyond the pavement

  // Buildings.
  double facade_m = 0.0;  ///< offset of the fronts
  Range setback_m = {0.0, 0.45};
  double house_length_m = 10.0;
  Range house_height_m = {9.0, 15.0};
  double house_depth_m = 8.0;
  double gap_share = 0.1;  ///< of the houses that are followed by a gap
  double gap_m = 5.0;
  double shop_share = 0.45;
  bool detached = false;  ///< gabled, with windows on all sides
  bool halls = false;     ///< large sheds with plain walls in place of houses
  Edging edging = Edging::kNone;

  // What stands along the road.
  double tree_every_m = 0.0;
  std::vector<Range> tree_rows_m;  ///< offsets of the rows of trees
  Range tree_height_m = {4.5, 8.0};
  int leaves_per_cluster = 110;
  double lamp_every_m = 30.0;
  double sign_every_m = 30.0;
  double furniture_every_m = 8.0;
  std::optional<Range> furniture_offset_m;  ///< none: at the pavement's far edge
  double column_every_m = 0.0;
  double monument_every_m = 0.0;
  double kiosk_every_m = 0.0;
  double container_every_m = 0.0;
  double fence_every_m = 0.0;
  double parked_share = 0.0;  ///< of the parking bays
};

/// All kinds of world.
const std::vector<WorldLayout>& WorldLayouts();

/// The layout of a kind, none for an unknown one.
const WorldLayout* FindWorldLayout(const std::string& kind);

}  // namespace scenecalib
