#include "scenecalib/association/track_association.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <optional>

namespace scenecalib {
namespace {

constexpr double kRadPerDeg = 0.017453292519943295;

double Kernel(double value, double sigma) {
  const double ratio = value / sigma;
  return std::exp(-0.5 * ratio * ratio);
}

TrackAssociation Rejected(AssociationOutcome outcome) {
  TrackAssociation association;
  association.outcome = outcome;
  return association;
}

TrackAssociation AssociateBundle(const std::vector<Ray>& rays, const RayCaster& caster,
                                 const AssociationGates& gates, const AssociationOptions& options) {
  std::vector<RayHit> hits;
  hits.reserve(rays.size());
  int num_planar = 0;
  for (const Ray& ray : rays) {
    const std::optional<RayHit> hit = caster.Cast(ray, options.max_range_m);
    if (!hit) continue;
    hits.push_back(*hit);
    if (hit->planar && hit->thickness_m <= options.max_thickness_m) ++num_planar;
  }
  const auto required = std::max<std::size_t>(
      2, static_cast<std::size_t>(std::ceil(options.min_hit_fraction * rays.size())));
  if (hits.size() < required) return Rejected(AssociationOutcome::kTooFewHits);
  if (2 * num_planar <= static_cast<int>(hits.size())) {
    return Rejected(AssociationOutcome::kNotPlanar);
  }
  // i* must be a plane, so rays stopped by foliage or an edge have no vote.
  hits.erase(std::remove_if(hits.begin(), hits.end(),
                            [&options](const RayHit& hit) {
                              return !hit.planar || hit.thickness_m > options.max_thickness_m;
                            }),
             hits.end());
  if (hits.size() < 2) return Rejected(AssociationOutcome::kNotPlanar);

  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Vector3d> normals;
  for (const RayHit& hit : hits) {
    points.push_back(hit.point_in_map_m);
    normals.push_back(hit.normal_in_map);
  }
  const BundleScores scores = ScoreBundle(points, normals, gates);
  const RayHit& best = hits[scores.best];
  TrackAssociation association;
  association.point_in_map_m = best.point_in_map_m;
  association.normal_in_map = best.normal_in_map;
  association.score_theta = scores.theta;
  association.score_d = scores.d;
  association.kind = best.kind;
  association.scale_m = best.scale_m;
  association.thickness_m = best.thickness_m;
  association.range_m = best.range_m;
  if (best.incidence_angle_rad > options.max_incidence_deg * kRadPerDeg) {
    association.outcome = AssociationOutcome::kGrazing;
  } else if (scores.theta < options.min_score_theta) {
    association.outcome = AssociationOutcome::kNormalsDisagree;
  } else if (scores.d < options.min_score_d) {
    association.outcome = AssociationOutcome::kDistancesDisagree;
  } else {
    association.outcome = AssociationOutcome::kAccepted;
  }
  return association;
}

}  // namespace

std::string ToString(AssociationOutcome outcome) {
  switch (outcome) {
    case AssociationOutcome::kAccepted:
      return "accepted";
    case AssociationOutcome::kTooFewHits:
      return "too few hits";
    case AssociationOutcome::kNotPlanar:
      return "not planar";
    case AssociationOutcome::kGrazing:
      return "grazing";
    case AssociationOutcome::kNormalsDisagree:
      return "normals disagree";
    case AssociationOutcome::kDistancesDisagree:
      return "distances disagree";
    case AssociationOutcome::kNotAsPredicted:
      return "edge, or not as the map predicts";
  }
  return "unknown";
}

BundleScores ScoreBundle(const std::vector<Eigen::Vector3d>& points_m,
                         const std::vector<Eigen::Vector3d>& normals,
                         const AssociationGates& gates) {
  const int n = static_cast<int>(points_m.size());
  BundleScores scores;
  double best_sum = -1.0;
  for (int i = 0; i < n; ++i) {
    double sum = 0.0;
    for (int j = 0; j < n; ++j) {
      if (j == i) continue;
      const double cosine = std::clamp(normals[i].dot(normals[j]), -1.0, 1.0);
      sum += Kernel(std::acos(cosine), gates.sigma_theta_rad);  // Eq. 5
    }
    if (sum > best_sum) {  // Eq. 7; the first of equals, so the choice is deterministic
      best_sum = sum;
      scores.best = i;
    }
  }
  scores.theta = best_sum / (n - 1);  // Eq. 6
  double sum_d = 0.0;
  for (int i = 0; i < n; ++i) {
    if (i == scores.best) continue;
    sum_d += Kernel(normals[i].dot(points_m[i] - points_m[scores.best]), gates.sigma_d_m);
  }
  scores.d = sum_d / (n - 1);  // Eq. 8
  return scores;
}

std::vector<TrackAssociation> AssociateTracks(const std::vector<std::vector<Ray>>& bundles,
                                              const RayCaster& caster,
                                              const AssociationGates& gates,
                                              const AssociationOptions& options) {
  std::vector<TrackAssociation> associations(bundles.size());
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, bundles.size(), 16),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t i = range.begin(); i != range.end(); ++i) {
                        associations[i] = AssociateBundle(bundles[i], caster, gates, options);
                      }
                    });
  return associations;
}

}  // namespace scenecalib
