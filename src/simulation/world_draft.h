#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/simulation/road_curve.h"
#include "scenecalib/simulation/world.h"
#include "world_layout.h"

namespace scenecalib {

/// A world in the making: what the parts that build it share. Positions are arc length s along the
/// road and offset d to its left. One stream of random numbers runs through everything, so the
/// order of the calls decides the world.
class WorldDraft {
 public:
  WorldDraft(const WorldLayout& layout, const RoadCurve& road, Random random);

  const WorldLayout& layout() const { return layout_; }
  const RoadCurve& road() const { return road_; }
  Random& random() { return random_; }
  World& world() { return world_; }
  double kerb_m() const { return kerb_m_; }

  std::uint32_t NextObject() { return next_object_++; }
  Random NextRandom() { return random_.Fork(random_.NextBits()); }
  /// A surface that is an object of its own.
  std::uint32_t NewSurface(Material material, const Eigen::Vector3f& albedo);
  /// Draws only where there is something to draw.
  double Draw(const Range& range) {
    return range.low < range.high ? random_.Uniform(range.low, range.high) : range.low;
  }

  /// A point on the ground (plus height), not past the centre of a bend.
  Eigen::Vector3d Ground(double s, double d, double above_m) const;
  /// False near or past the centre of a bend.
  bool HasRoom(double s, double d) const { return road_.Curvature(s) * d < 0.6; }

  /// Calls add(s) about every `every_m` metres; never for 0.
  template <typename Add>
  void Every(double every_m, const Add& add) {
    if (every_m <= 0.0) return;
    double s = road_.start_s_m() + random_.Uniform(0.0, every_m);
    while (s < road_.end_s_m() - 2.0) {
      add(s);
      s += every_m * random_.Uniform(0.7, 1.3);
    }
  }

  /// Remembers where a building stands; d0 and d1 on the same side.
  void AddFootprint(double s0, double s1, double d0, double d1);
  /// Whether something of that radius would stand in a building.
  bool IsBuiltOn(double s, double d, double radius_m) const;

 private:
  struct Footprint {
    Range s, d;
  };

  double GroundHeight(double s, double d) const;

  const WorldLayout& layout_;
  const RoadCurve& road_;
  Random random_;
  double kerb_m_;
  std::uint32_t next_object_ = 1;
  std::vector<Footprint> footprints_;
  World world_;
};

/// The ground: road, kerbs, pavements, what lies beyond them.
void AddGround(WorldDraft* draft);
/// Houses or halls along one side (-1 right, 1 left), with what stands before them.
void AddBuildings(double side, WorldDraft* draft);
/// Houses across both ends of the road.
void AddEnds(WorldDraft* draft);
/// Trees, lamps, signs and what else stands along one side.
void AddAlong(double side, WorldDraft* draft);
/// A house whose front runs from (s0, d0) to (s1, d1).
void AddHouseAt(double s0, double d0, double s1, double d1, double depth_m, double height_m,
                bool shop, bool detached, WorldDraft* draft);

}  // namespace scenecalib
