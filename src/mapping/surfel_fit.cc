#include "surfel_fit.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "planar_patch.h"
#include "plane_fit.h"

namespace scenecalib {
namespace {

constexpr float kInlierSigmas = 2.5F;
/// Fits see this much around their voxel: a plane that runs along a voxel's face would otherwise
/// lose half of its noise and shift by a standard deviation.
constexpr float kMarginSigmas = 4.0F;
/// Planes peeled off one voxel before it is split.
constexpr int kMaxPlanesPerVoxel = 3;
/// A patch smaller than this share of a voxel's face, or narrower than this share of its edge, is
/// left to the finer levels.
constexpr float kMinAreaShare = 0.25F;
constexpr float kMinWidthShare = 0.35F;
/// A patch has to explain this share of the voxel's points near its plane, and in voxels of at most
/// kFineEdge_m of all of them: in foliage every slab holds some points that look like a plane.
constexpr float kMinExplainedShare = 0.5F;
constexpr float kNearSigmas = 8.0F;
constexpr float kFineEdge_m = 0.5F;
/// RMS about the plane of a planar patch, of what range noise makes of it at the rays' angles, plus
/// so many standard deviations of that RMS. Points spread evenly over the inliers' slab, as leaves
/// are, come to 1.44 of the noise, and more where the slab is seen obliquely.
constexpr float kMaxThicknessRatio = 1.15F;
constexpr float kThicknessSlack = 0.7F;
/// Share of the noise that does not lie along the ray (trajectory, footprint on oblique surfaces).
constexpr float kLateralShare = 0.5F;
/// Depth of a patch's rim behind its plane.
constexpr float kRimDepth_m = 0.015F;
/// Where more than this share of the points that the large planes leave over lies on no plane at
/// all, what small planes there are is chance: foliage. Judged in voxels of at most kJudgeEdge_m.
constexpr float kMaxClutterShare = 0.35F;
constexpr float kJudgeEdge_m = 1.0F;
/// Points too few to make an occluder are pooled in voxels of up to this edge.
constexpr float kLargestOccluder_m = 0.45F;
/// Noise is read off voxels of this edge that hold at least so many points.
constexpr float kNoiseVoxel_m = 0.4F;
constexpr int kNoisePoints = 60;
/// Rank of the noise among them: walls seen head-on show all of the range noise, oblique ones less.
constexpr double kNoiseQuantile = 0.6;

/// A point as the voxel fits see it.
struct LocalPoint {
  Eigen::Vector3f position_m;
  int index;  // into the scene points
};

/// Square of the share of a return's noise that lies across a plane.
float NoiseShareSquared(const Eigen::Vector3f& normal, const LidarReturn& point) {
  const float cosine = normal.dot((point.position_m - point.origin_m).normalized());
  constexpr float kLateral = kLateralShare * kLateralShare;
  return kLateral + (1.0F - kLateral) * cosine * cosine;
}

/// Fits one coarsest voxel and its parts.
class VoxelFitter {
 public:
  VoxelFitter(const std::vector<LidarReturn>& points, const std::vector<Timestamp>& stamps_ns,
              const SurfelOptions& options, const SurfaceNoise& noise, Random random)
      : points_(points),
        stamps_ns_(stamps_ns),
        options_(options),
        noise_m_(static_cast<float>(noise.across_m)),
        ray_noise_m_(static_cast<float>(noise.along_ray_m)),
        random_(random) {}

  /// What became of the points of a voxel.
  struct Outcome {
    int num_on_small = 0;           ///< on planes of voxels up to kFineEdge_m
    int num_clutter = 0;            ///< on no plane
    std::vector<LocalPoint> loose;  ///< of those, the ones without an occluder
  };

  /// `local` holds the points of the box [corner, corner + edge) and of its margin.
  Outcome Fit(std::vector<LocalPoint> local, const Eigen::Vector3f& corner_m, float edge_m,
              int level);

  std::vector<Surfel> surfels;

 private:
  int PeelPlane(std::vector<LocalPoint>* local, const Eigen::Vector3f& corner_m, float edge_m);
  void FitParts(const std::vector<LocalPoint>& local, const Eigen::Vector3f& corner_m, float edge_m,
                int level, Outcome* outcome);
  bool IsThin(const PlaneFit& plane, const std::vector<int>& indices) const;
  void AddOccluder(const std::vector<LocalPoint>& local, float edge_m);
  void AddDiscs(const PlaneFit& plane, const PlanarPatch& patch,
                const std::vector<int>& own_indices, float edge_m);
  static bool Inside(const Eigen::Vector3f& p, const Eigen::Vector3f& corner_m, float edge_m,
                     float margin_m = 0.0F) {
    const Eigen::Array3f offset = (p - corner_m).array();
    return (offset >= -margin_m).all() && (offset < edge_m + margin_m).all();
  }
  float Margin(float edge_m) const { return std::min(kMarginSigmas * noise_m_, 0.5F * edge_m); }
  void Stamp(const std::vector<int>& indices, Surfel* surfel) const;

  const std::vector<LidarReturn>& points_;
  const std::vector<Timestamp>& stamps_ns_;
  const SurfelOptions& options_;
  const float noise_m_;      // across surfaces
  const float ray_noise_m_;  // along rays
  Random random_;
};

/// Direction to the sensor, and when the surfel was seen.
void VoxelFitter::Stamp(const std::vector<int>& indices, Surfel* surfel) const {
  Eigen::Vector3f to_sensor = Eigen::Vector3f::Zero();
  int first_scan = points_[indices.front()].scan;
  int last_scan = first_scan;
  for (const int i : indices) {
    to_sensor += (points_[i].origin_m - points_[i].position_m).normalized();
    first_scan = std::min(first_scan, points_[i].scan);
    last_scan = std::max(last_scan, points_[i].scan);
  }
  if (!surfel->planar) {
    if (to_sensor.norm() > 1e-6F) surfel->normal = to_sensor.normalized();
  } else if (surfel->normal.dot(to_sensor) < 0.0F) {
    surfel->normal = -surfel->normal;
  }
  surfel->num_points = static_cast<int>(indices.size());
  surfel->first_seen_ns = stamps_ns_[first_scan];
  surfel->last_seen_ns = stamps_ns_[last_scan];
}

void VoxelFitter::AddDiscs(const PlaneFit& plane, const PlanarPatch& patch,
                           const std::vector<int>& own_indices, float edge_m) {
  Surfel surfel;
  surfel.normal = plane.normal;
  surfel.thickness_m = plane.thickness_m;
  surfel.scale_m = edge_m;
  surfel.planar = true;
  Stamp(own_indices, &surfel);
  for (const PatchDisc& disc : patch.Discs()) {
    surfel.center_m = disc.center_m;
    // The rim lies behind the discs that it surrounds, as seen from the sensor.
    if (disc.at_border) surfel.center_m -= kRimDepth_m * surfel.normal;
    surfel.radius_m = disc.radius_m;
    surfel.planar = !disc.at_border;
    surfels.push_back(surfel);
  }
}

/// Whether points are no farther from their plane than noise along their rays puts them.
bool VoxelFitter::IsThin(const PlaneFit& plane, const std::vector<int>& indices) const {
  float squares = 0.0F;
  for (const int i : indices) {
    squares += NoiseShareSquared(plane.normal, points_[i]);
  }
  const auto count = static_cast<float>(indices.size());
  const float expected_m = ray_noise_m_ * std::sqrt(squares / count);
  return plane.thickness_m <=
         expected_m * (kMaxThicknessRatio + kThicknessSlack / std::sqrt(2.0F * count));
}

/// Returns the number of the voxel's own points on the plane that was found; 0: none.
int VoxelFitter::PeelPlane(std::vector<LocalPoint>* local, const Eigen::Vector3f& corner_m,
                           float edge_m) {
  const float margin_m = Margin(edge_m);
  std::vector<Eigen::Vector3f> positions;
  std::vector<int> indices;
  std::vector<char> own;
  int num_own = 0;
  for (const LocalPoint& point : *local) {
    if (!Inside(point.position_m, corner_m, edge_m, margin_m)) continue;
    positions.push_back(point.position_m);
    indices.push_back(point.index);
    own.push_back(Inside(point.position_m, corner_m, edge_m) ? 1 : 0);
    num_own += own.back();
  }
  if (num_own < options_.min_points_planar) return 0;
  std::optional<PlaneFit> plane = FitPlane(positions, kInlierSigmas * noise_m_,
                                           options_.min_points_planar, random_.Fork(num_own));
  if (!plane) return 0;
  const PatchGates gates{noise_m_, static_cast<float>(options_.max_bias_m)};
  {
    // Only the cells that lie on the plane may say where it is.
    const PlanarPatch first(*plane, positions, own, edge_m, gates);
    std::vector<Eigen::Vector3f> explained;
    std::vector<int> explained_indices;
    for (std::size_t i = 0; i < positions.size(); ++i) {
      if (!first.Explains(positions[i])) continue;
      explained.push_back(positions[i]);
      explained_indices.push_back(indices[i]);
    }
    plane = FitPlaneToAll(explained);
    if (!plane || plane->num_inliers < options_.min_points_planar ||
        !IsThin(*plane, explained_indices)) {
      return 0;
    }
  }
  const PlanarPatch patch(*plane, positions, own, edge_m, gates);
  if (patch.area_m2() < kMinAreaShare * edge_m * edge_m ||
      patch.narrow_extent_m() < kMinWidthShare * edge_m) {
    return 0;
  }
  std::vector<LocalPoint> rest;
  std::vector<int> own_indices;
  int num_rivals = 0;  // own points that the patch should explain
  for (const LocalPoint& point : *local) {
    const bool is_own = Inside(point.position_m, corner_m, edge_m);
    if (is_own && (edge_m < kFineEdge_m ||
                   std::abs(plane->Distance(point.position_m)) < kNearSigmas * noise_m_)) {
      ++num_rivals;
    }
    if (patch.Explains(point.position_m)) {
      if (is_own) own_indices.push_back(point.index);
    } else if (!patch.Absorbs(point.position_m)) {
      rest.push_back(point);
    }
  }
  const auto num_explained = static_cast<int>(own_indices.size());
  if (num_explained < options_.min_points_planar ||
      static_cast<float>(num_explained) < kMinExplainedShare * static_cast<float>(num_rivals)) {
    return 0;
  }
  AddDiscs(*plane, patch, own_indices, edge_m);
  *local = std::move(rest);
  return num_explained;
}

/// A disc across the view that is about as large as the points' spread.
void VoxelFitter::AddOccluder(const std::vector<LocalPoint>& local, float edge_m) {
  Eigen::Vector3f mean_m = Eigen::Vector3f::Zero();
  std::vector<int> indices;
  for (const LocalPoint& point : local) {
    mean_m += point.position_m;
    indices.push_back(point.index);
  }
  mean_m /= static_cast<float>(local.size());
  float mean_square = 0.0F;
  for (const LocalPoint& point : local) mean_square += (point.position_m - mean_m).squaredNorm();
  mean_square /= static_cast<float>(local.size());
  Surfel surfel;
  surfel.planar = false;
  surfel.center_m = mean_m;
  surfel.radius_m = std::clamp(1.4F * std::sqrt(mean_square), 0.25F * edge_m, 0.6F * edge_m);
  surfel.scale_m = edge_m;
  surfel.thickness_m = std::sqrt(mean_square);
  Stamp(indices, &surfel);
  surfels.push_back(surfel);
}

VoxelFitter::Outcome VoxelFitter::Fit(std::vector<LocalPoint> local,
                                      const Eigen::Vector3f& corner_m, float edge_m, int level) {
  const std::size_t first_surfel = surfels.size();
  Outcome outcome;
  for (int i = 0; i < kMaxPlanesPerVoxel; ++i) {
    const int num_on_plane = PeelPlane(&local, corner_m, edge_m);
    if (num_on_plane == 0) break;
    if (edge_m < kFineEdge_m) outcome.num_on_small += num_on_plane;
  }
  if (level + 1 >= options_.num_levels) {
    for (const LocalPoint& point : local) {
      if (Inside(point.position_m, corner_m, edge_m)) outcome.loose.push_back(point);
    }
    outcome.num_clutter = static_cast<int>(outcome.loose.size());
  } else {
    FitParts(local, corner_m, edge_m, level, &outcome);
  }
  if (static_cast<int>(outcome.loose.size()) >= options_.min_points_occluder &&
      edge_m < kLargestOccluder_m) {
    AddOccluder(outcome.loose, edge_m);
    outcome.loose.clear();
  }
  if (edge_m <= kJudgeEdge_m && 2.0F * edge_m > kJudgeEdge_m &&
      static_cast<float>(outcome.num_clutter) >
          kMaxClutterShare * static_cast<float>(outcome.num_clutter + outcome.num_on_small)) {
    for (std::size_t i = first_surfel; i < surfels.size(); ++i) {
      if (surfels[i].scale_m < kFineEdge_m) surfels[i].planar = false;
    }
  }
  return outcome;
}

void VoxelFitter::FitParts(const std::vector<LocalPoint>& local, const Eigen::Vector3f& corner_m,
                           float edge_m, int level, Outcome* outcome) {
  const float half_m = 0.5F * edge_m;
  const float margin_m = Margin(half_m);
  for (int part = 0; part < 8; ++part) {
    const Eigen::Vector3f part_corner_m =
        corner_m + half_m * Eigen::Vector3f(static_cast<float>(part & 1),
                                            static_cast<float>((part >> 1) & 1),
                                            static_cast<float>((part >> 2) & 1));
    std::vector<LocalPoint> of_part;
    bool has_own = false;
    for (const LocalPoint& point : local) {
      if (!Inside(point.position_m, part_corner_m, half_m, margin_m)) continue;
      of_part.push_back(point);
      has_own |= Inside(point.position_m, part_corner_m, half_m);
    }
    if (!has_own) continue;
    Outcome inner = Fit(std::move(of_part), part_corner_m, half_m, level + 1);
    outcome->num_on_small += inner.num_on_small;
    outcome->num_clutter += inner.num_clutter;
    outcome->loose.insert(outcome->loose.end(), inner.loose.begin(), inner.loose.end());
  }
}

/// The lowest corner of the voxel that holds a point.
Eigen::Vector3f CornerOf(const Eigen::Vector3f& point_m, float edge_m) {
  return ((point_m * (1.0F / edge_m)).array().floor() * edge_m).matrix();
}

/// Voxels' points with those of their margins.
class VoxelMargins {
 public:
  VoxelMargins(const std::vector<LidarReturn>& points, const VoxelGroups& voxels, float edge_m,
               float margin_m)
      : points_(points), voxels_(voxels), edge_m_(edge_m), margin_m_(margin_m) {
    // By a little more than the margin: corners are rounded.
    const float inner_m = 1.01F * margin_m + 1e-3F;
    for (int v = 0; v < voxels.size(); ++v) {
      border_begin_.push_back(border_.size());
      const Eigen::Vector3f corner_m = Corner(v);
      for (int k = voxels.begin[v]; k < voxels.begin[v + 1]; ++k) {
        const Eigen::Vector3f& position_m = points[voxels.order[k]].position_m;
        const Eigen::Array3f offset = (position_m - corner_m).array();
        if ((offset > inner_m).all() && (offset < edge_m - inner_m).all()) continue;
        border_.push_back({position_m, voxels.order[k]});
      }
    }
    border_begin_.push_back(border_.size());
  }

  /// The lowest corner of a voxel.
  Eigen::Vector3f Corner(int v) const {
    return CornerOf(points_[voxels_.order[voxels_.begin[v]]].position_m, edge_m_);
  }

  /// From the voxel and its 26 neighbours.
  std::vector<LocalPoint> Gather(int v) const {
    const Eigen::Vector3f corner_m = Corner(v);
    std::vector<LocalPoint> local;
    const auto add = [&](const LocalPoint& point) {
      const Eigen::Array3f offset = (point.position_m - corner_m).array();
      if ((offset < -margin_m_).any() || (offset >= edge_m_ + margin_m_).any()) return;
      local.push_back(point);
    };
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dz = -1; dz <= 1; ++dz) {
          if (dx == 0 && dy == 0 && dz == 0) {
            for (int k = voxels_.begin[v]; k < voxels_.begin[v + 1]; ++k) {
              add({points_[voxels_.order[k]].position_m, voxels_.order[k]});
            }
            continue;
          }
          const int neighbor = voxels_.Find(NeighborVoxelKey(voxels_.keys[v], dx, dy, dz));
          if (neighbor < 0) continue;
          for (std::size_t k = border_begin_[neighbor]; k < border_begin_[neighbor + 1]; ++k) {
            add(border_[k]);
          }
        }
      }
    }
    return local;
  }

 private:
  const std::vector<LidarReturn>& points_;
  const VoxelGroups& voxels_;
  const float edge_m_;
  const float margin_m_;
  /// Points so near to a face of their voxel that a neighbour's margin may hold them, by voxel.
  std::vector<LocalPoint> border_;
  std::vector<std::size_t> border_begin_;
};

/// Of the entries that are not negative.
double QuantileOfKnown(std::vector<float> values, double share, double none) {
  values.erase(std::remove_if(values.begin(), values.end(), [](float x) { return x < 0.0F; }),
               values.end());
  if (values.empty()) return none;
  const auto rank = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size()));
  std::nth_element(values.begin(), values.begin() + rank, values.end());
  return values[rank];
}

}  // namespace

SurfaceNoise EstimateSurfaceNoise(const std::vector<LidarReturn>& points, const VoxelGroups& voxels,
                                  const SurfelOptions& options) {
  std::vector<float> across_m(voxels.size(), -1.0F);
  std::vector<float> along_ray_m(voxels.size(), -1.0F);
  // With a margin, and a wide gate: neither must cut the noise that is to be measured.
  const VoxelMargins margins(points, voxels, kNoiseVoxel_m,
                             static_cast<float>(options.max_noise_m));
  tbb::parallel_for(0, voxels.size(), [&](int v) {
    if (voxels.begin[v + 1] - voxels.begin[v] < kNoisePoints) return;
    const std::vector<LocalPoint> local = margins.Gather(v);
    std::vector<Eigen::Vector3f> positions;
    for (const LocalPoint& point : local) positions.push_back(point.position_m);
    const auto plane = FitPlane(positions, static_cast<float>(options.max_noise_m),
                                kNoisePoints / 2, Random(voxels.keys[v]));
    if (!plane || plane->num_inliers < 0.8 * static_cast<double>(positions.size())) return;
    float share = 0.0F;
    for (const LocalPoint& point : local) {
      share += NoiseShareSquared(plane->normal, points[point.index]);
    }
    across_m[v] = plane->thickness_m;
    along_ray_m[v] = plane->thickness_m / std::sqrt(share / static_cast<float>(positions.size()));
  });
  const auto bounded = [&](double noise_m) {
    return std::clamp(noise_m, options.min_noise_m, options.max_noise_m);
  };
  return {bounded(QuantileOfKnown(std::move(across_m), kNoiseQuantile, options.max_noise_m)),
          bounded(QuantileOfKnown(std::move(along_ray_m), 0.5, options.max_noise_m))};
}

std::vector<Surfel> FitSurfels(const std::vector<LidarReturn>& points,
                               const std::vector<PointLabel>& labels,
                               const std::vector<Timestamp>& stamps_ns,
                               const SurfelOptions& options) {
  std::vector<int> structure;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (labels[i] != PointLabel::kStructure) continue;
    if ((points[i].position_m - points[i].origin_m).norm() > options.max_range_m) continue;
    structure.push_back(static_cast<int>(i));
  }
  const SurfaceNoise noise =
      EstimateSurfaceNoise(points, GroupByVoxel(points, structure, kNoiseVoxel_m), options);
  const float margin_m = kMarginSigmas * static_cast<float>(noise.across_m);
  const VoxelGroups voxels = GroupByVoxel(points, structure, options.coarsest_voxel_m);
  const auto edge_m = static_cast<float>(options.coarsest_voxel_m);
  const VoxelMargins margins(points, voxels, edge_m, margin_m);
  std::vector<std::vector<Surfel>> of_voxel(voxels.size());
  tbb::parallel_for(0, voxels.size(), [&](int v) {
    VoxelFitter fitter(points, stamps_ns, options, noise, Random(voxels.keys[v]));
    fitter.Fit(margins.Gather(v), margins.Corner(v), edge_m, 0);
    of_voxel[v] = std::move(fitter.surfels);
  });
  std::vector<Surfel> surfels;
  for (const auto& of_one : of_voxel) surfels.insert(surfels.end(), of_one.begin(), of_one.end());
  return surfels;
}

}  // namespace scenecalib
