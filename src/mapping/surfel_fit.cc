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
/// RMS about the plane of a planar patch, in noise standard deviations.
constexpr float kMaxThicknessSigmas = 1.5F;
/// Noise is read off voxels of this edge that hold at least so many points.
constexpr double kNoiseVoxel_m = 0.4;
constexpr int kNoisePoints = 60;
/// Rank of the noise among them: walls seen head-on show all of the range noise, oblique ones less.
constexpr double kNoiseQuantile = 0.6;

/// A point as the voxel fits see it.
struct LocalPoint {
  Eigen::Vector3f position_m;
  int index;  // into the scene points
};

/// Fits one coarsest voxel and its parts.
class VoxelFitter {
 public:
  VoxelFitter(const std::vector<ScenePoint>& points, const std::vector<Timestamp>& stamps_ns,
              const SurfelOptions& options, float noise_m, Random random)
      : points_(points),
        stamps_ns_(stamps_ns),
        options_(options),
        noise_m_(noise_m),
        random_(random) {}

  /// `local` holds the points of the box [corner, corner + edge) and of its margin.
  void Fit(std::vector<LocalPoint> local, const Eigen::Vector3f& corner_m, float edge_m, int level);

  std::vector<Surfel> surfels;

 private:
  bool PeelPlane(std::vector<LocalPoint>* local, const Eigen::Vector3f& corner_m, float edge_m);
  void AddOccluder(const std::vector<LocalPoint>& local, const Eigen::Vector3f& corner_m,
                   float edge_m);
  void AddDiscs(const PlaneFit& plane, const PlanarPatch& patch,
                const std::vector<int>& own_indices, float edge_m);
  static bool Inside(const Eigen::Vector3f& p, const Eigen::Vector3f& corner_m, float edge_m,
                     float margin_m = 0.0F) {
    const Eigen::Array3f offset = (p - corner_m).array();
    return (offset >= -margin_m).all() && (offset < edge_m + margin_m).all();
  }
  float Margin(float edge_m) const { return std::min(kMarginSigmas * noise_m_, 0.5F * edge_m); }
  void Stamp(const std::vector<int>& indices, Surfel* surfel) const;

  const std::vector<ScenePoint>& points_;
  const std::vector<Timestamp>& stamps_ns_;
  const SurfelOptions& options_;
  const float noise_m_;
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
    surfel.radius_m = disc.radius_m;
    surfels.push_back(surfel);
  }
}

bool VoxelFitter::PeelPlane(std::vector<LocalPoint>* local, const Eigen::Vector3f& corner_m,
                            float edge_m) {
  const float margin_m = Margin(edge_m);
  std::vector<Eigen::Vector3f> positions;
  std::vector<char> own;
  int num_own = 0;
  for (const LocalPoint& point : *local) {
    if (!Inside(point.position_m, corner_m, edge_m, margin_m)) continue;
    positions.push_back(point.position_m);
    own.push_back(Inside(point.position_m, corner_m, edge_m) ? 1 : 0);
    num_own += own.back();
  }
  if (num_own < options_.min_points_planar) return false;
  std::optional<PlaneFit> plane = FitPlane(positions, kInlierSigmas * noise_m_,
                                           options_.min_points_planar, random_.Fork(num_own));
  if (!plane) return false;
  const PatchGates gates{noise_m_, static_cast<float>(options_.max_bias_m)};
  {
    // Only the cells that lie on the plane may say where it is.
    const PlanarPatch first(*plane, positions, own, edge_m, gates);
    std::vector<Eigen::Vector3f> explained;
    for (const Eigen::Vector3f& position : positions) {
      if (first.Explains(position)) explained.push_back(position);
    }
    plane = FitPlaneToAll(explained);
    if (!plane || plane->num_inliers < options_.min_points_planar) return false;
  }
  const PlanarPatch patch(*plane, positions, own, edge_m, gates);
  if (plane->thickness_m > kMaxThicknessSigmas * noise_m_ ||
      patch.area_m2() < kMinAreaShare * edge_m * edge_m ||
      patch.narrow_extent_m() < kMinWidthShare * edge_m) {
    return false;
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
    if (!patch.Explains(point.position_m)) {
      rest.push_back(point);
    } else if (is_own) {
      own_indices.push_back(point.index);
    }
  }
  if (static_cast<int>(own_indices.size()) < options_.min_points_planar ||
      static_cast<float>(own_indices.size()) <
          kMinExplainedShare * static_cast<float>(num_rivals)) {
    return false;
  }
  AddDiscs(*plane, patch, own_indices, edge_m);
  *local = std::move(rest);
  return true;
}

void VoxelFitter::AddOccluder(const std::vector<LocalPoint>& local, const Eigen::Vector3f& corner_m,
                              float edge_m) {
  std::vector<Eigen::Vector3f> positions;
  std::vector<int> indices;
  for (const LocalPoint& point : local) {
    if (!Inside(point.position_m, corner_m, edge_m)) continue;
    positions.push_back(point.position_m);
    indices.push_back(point.index);
  }
  if (static_cast<int>(indices.size()) < options_.min_points_occluder) return;
  Eigen::Vector3f mean_m = Eigen::Vector3f::Zero();
  for (const Eigen::Vector3f& position : positions) mean_m += position;
  mean_m /= static_cast<float>(positions.size());
  float mean_square = 0.0F;
  for (const Eigen::Vector3f& position : positions)
    mean_square += (position - mean_m).squaredNorm();
  mean_square /= static_cast<float>(positions.size());
  Surfel surfel;
  surfel.planar = false;
  surfel.center_m = mean_m;
  surfel.radius_m = std::clamp(1.4F * std::sqrt(mean_square), 0.25F * edge_m, 0.6F * edge_m);
  surfel.scale_m = edge_m;
  surfel.thickness_m = std::sqrt(mean_square);
  Stamp(indices, &surfel);
  surfels.push_back(surfel);
}

void VoxelFitter::Fit(std::vector<LocalPoint> local, const Eigen::Vector3f& corner_m, float edge_m,
                      int level) {
  for (int i = 0; i < kMaxPlanesPerVoxel; ++i) {
    if (!PeelPlane(&local, corner_m, edge_m)) break;
  }
  if (level + 1 >= options_.num_levels) {
    AddOccluder(local, corner_m, edge_m);
    return;
  }
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
    if (has_own) Fit(std::move(of_part), part_corner_m, half_m, level + 1);
  }
}

/// The points of a voxel and of its margin, from the voxel and its 26 neighbours.
std::vector<LocalPoint> Gather(const std::vector<ScenePoint>& points, const VoxelGroups& voxels,
                               int v, const Eigen::Vector3f& corner_m, float edge_m,
                               float margin_m) {
  std::vector<LocalPoint> local;
  for (int dx = -1; dx <= 1; ++dx) {
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dz = -1; dz <= 1; ++dz) {
        const int neighbor = voxels.Find(NeighborVoxelKey(voxels.keys[v], dx, dy, dz));
        if (neighbor < 0) continue;
        for (int k = voxels.begin[neighbor]; k < voxels.begin[neighbor + 1]; ++k) {
          const Eigen::Vector3f& position_m = points[voxels.order[k]].position_m;
          const Eigen::Array3f offset = (position_m - corner_m).array();
          if ((offset < -margin_m).any() || (offset >= edge_m + margin_m).any()) continue;
          local.push_back({position_m, voxels.order[k]});
        }
      }
    }
  }
  return local;
}

}  // namespace

double EstimateSurfaceNoise(const std::vector<ScenePoint>& points, const VoxelGroups& voxels,
                            const SurfelOptions& options) {
  std::vector<double> thickness_m(voxels.size(), -1.0);
  tbb::parallel_for(0, voxels.size(), [&](int v) {
    if (voxels.begin[v + 1] - voxels.begin[v] < kNoisePoints) return;
    std::vector<Eigen::Vector3f> positions;
    for (int k = voxels.begin[v]; k < voxels.begin[v + 1]; ++k) {
      positions.push_back(points[voxels.order[k]].position_m);
    }
    // A wide gate: it must not cut the noise that it is to measure.
    const auto plane = FitPlane(positions, static_cast<float>(options.max_noise_m),
                                kNoisePoints / 2, Random(voxels.keys[v]));
    if (!plane || plane->num_inliers < 0.8 * static_cast<double>(positions.size())) return;
    thickness_m[v] = plane->thickness_m;
  });
  std::vector<double> found;
  for (const double t : thickness_m) {
    if (t >= 0.0) found.push_back(t);
  }
  if (found.empty()) return options.max_noise_m;
  const auto rank = static_cast<std::ptrdiff_t>(kNoiseQuantile * static_cast<double>(found.size()));
  std::nth_element(found.begin(), found.begin() + rank, found.end());
  return std::clamp(found[rank], options.min_noise_m, options.max_noise_m);
}

std::vector<Surfel> FitSurfels(const std::vector<ScenePoint>& points,
                               const std::vector<PointLabel>& labels,
                               const std::vector<Timestamp>& stamps_ns,
                               const SurfelOptions& options) {
  std::vector<int> structure;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (labels[i] != PointLabel::kStructure) continue;
    if ((points[i].position_m - points[i].origin_m).norm() > options.max_range_m) continue;
    structure.push_back(static_cast<int>(i));
  }
  const auto noise_m = static_cast<float>(
      EstimateSurfaceNoise(points, GroupByVoxel(points, structure, kNoiseVoxel_m), options));
  const VoxelGroups voxels = GroupByVoxel(points, structure, options.coarsest_voxel_m);
  const auto edge_m = static_cast<float>(options.coarsest_voxel_m);
  std::vector<std::vector<Surfel>> of_voxel(voxels.size());
  tbb::parallel_for(0, voxels.size(), [&](int v) {
    const Eigen::Vector3f& any_m = points[voxels.order[voxels.begin[v]]].position_m;
    const Eigen::Vector3f corner_m = ((any_m * (1.0F / edge_m)).array().floor() * edge_m).matrix();
    VoxelFitter fitter(points, stamps_ns, options, noise_m, Random(voxels.keys[v]));
    fitter.Fit(Gather(points, voxels, v, corner_m, edge_m, kMarginSigmas * noise_m), corner_m,
               edge_m, 0);
    of_voxel[v] = std::move(fitter.surfels);
  });
  std::vector<Surfel> surfels;
  for (const auto& of_one : of_voxel) surfels.insert(surfels.end(), of_one.begin(), of_one.end());
  return surfels;
}

}  // namespace scenecalib
