#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/mapping/ray_caster.h"

namespace scenecalib {

/// Gates of one round of track-to-map association; rounds go from coarse to fine (III-C).
struct AssociationGates {
  double sigma_theta_rad = 0.17;  ///< sigma_theta of Eq. 5
  double sigma_d_m = 0.06;        ///< sigma_d of Eq. 8
};

/// What holds in every round.
struct AssociationOptions {
  double min_score_theta = 0.6;
  double min_score_d = 0.6;
  double min_hit_fraction = 0.7;
  double max_range_m = 80.0;
  double max_incidence_deg = 84.0;
  double max_thickness_m = 0.06;
  void Visit(OptionVisitor& v) {
    v.Field("min_score_theta", &min_score_theta, {0.0, 1.0}, "least s_theta of an accepted track");
    v.Field("min_score_d", &min_score_d, {0.0, 1.0}, "least s_d of an accepted track");
    v.Field("min_hit_fraction", &min_hit_fraction, {0.0, 1.0},
            "least share of a track's rays that meet a surface");
    v.Field("max_range_m", &max_range_m, {1.0, 1000.0}, "rays are followed this far");
    v.Field("max_incidence_deg", &max_incidence_deg, {10.0, 90.0},
            "flattest view of the surface, from its normal, that still fixes a point on it");
    v.Field("max_thickness_m", &max_thickness_m, {0.001, 1.0},
            "thickest surface that counts as a plane");
  }
};

/// Why a track was not tied to a surface.
enum class AssociationOutcome {
  kAccepted,
  kTooFewHits,         ///< the rays leave the map or its range
  kNotPlanar,          ///< foliage, an edge, clutter
  kGrazing,            ///< seen too flat to fix a point
  kNormalsDisagree,    ///< s_theta below its threshold
  kDistancesDisagree,  ///< s_d below its threshold
  kNotAsPredicted,     ///< registered through the map it was at its surface's edge, or not found
};
constexpr int kNumAssociationOutcomes = 7;

/// "accepted", "too few hits", ...
std::string ToString(AssociationOutcome outcome);

/// A ray bundle's tie to a plane, with the scores that decided it.
struct TrackAssociation {
  AssociationOutcome outcome = AssociationOutcome::kTooFewHits;
  Eigen::Vector3d point_in_map_m = Eigen::Vector3d::Zero();  ///< x_{i*}
  Eigen::Vector3d normal_in_map = Eigen::Vector3d::UnitZ();  ///< n_{i*}, unit
  double score_theta = 0.0;                                  ///< s_theta, Eq. 6
  double score_d = 0.0;                                      ///< s_d, Eq. 8
  SurfaceKind kind = SurfaceKind::kGround;
  double scale_m = 0.0;
  double thickness_m = 0.0;
  double range_m = 0.0;  ///< of the hit i*
  bool accepted() const { return outcome == AssociationOutcome::kAccepted; }
};

/// Scores of a bundle's intersection points and normals, Eq. (5)-(8). `best` is i*.
struct BundleScores {
  double theta = 0.0;
  double d = 0.0;
  int best = 0;
};

/// At least two intersections are needed.
BundleScores ScoreBundle(const std::vector<Eigen::Vector3d>& points_m,
                         const std::vector<Eigen::Vector3d>& normals,
                         const AssociationGates& gates);

/// Ties every bundle (one per track: its back-projected rays, in the map frame) to a plane, or says
/// why not. Parallel; the order of the result is that of the input.
std::vector<TrackAssociation> AssociateTracks(const std::vector<std::vector<Ray>>& bundles,
                                              const RayCaster& caster,
                                              const AssociationGates& gates,
                                              const AssociationOptions& options);

}  // namespace scenecalib
