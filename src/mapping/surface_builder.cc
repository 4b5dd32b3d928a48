#include "scenecalib/mapping/surface_builder.h"

#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <string>
#include <utility>

#include "ground_mesh.h"
#include "ground_segmentation.h"
#include "lidar_return.h"
#include "moving_objects.h"
#include "surfel_fit.h"

namespace scenecalib {
namespace {

constexpr char kStage[] = "mapping: surfaces";

/// One averaged point per voxel of what does not move.
std::vector<MapPoint> ThinCloud(const std::vector<LidarReturn>& points,
                                const std::vector<PointLabel>& labels, double voxel_size_m) {
  std::vector<int> kept;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (labels[i] != PointLabel::kMoving) kept.push_back(static_cast<int>(i));
  }
  const VoxelGroups voxels = GroupByVoxel(points, kept, voxel_size_m);
  std::vector<MapPoint> cloud(voxels.size());
  for (int v = 0; v < voxels.size(); ++v) {
    Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
    double intensity = 0.0;
    for (int k = voxels.begin[v]; k < voxels.begin[v + 1]; ++k) {
      position_m += points[voxels.order[k]].position_m.cast<double>();
      intensity += points[voxels.order[k]].intensity;
    }
    const double count = voxels.begin[v + 1] - voxels.begin[v];
    cloud[v] = {(position_m / count).cast<float>(), static_cast<float>(intensity / count)};
  }
  return cloud;
}

double MedianPlanarThickness(const std::vector<Surfel>& surfels) {
  std::vector<float> thickness_m;
  for (const Surfel& surfel : surfels) {
    if (surfel.planar) thickness_m.push_back(surfel.thickness_m);
  }
  if (thickness_m.empty()) return 0.0;
  const auto middle = thickness_m.begin() + static_cast<std::ptrdiff_t>(thickness_m.size() / 2);
  std::nth_element(thickness_m.begin(), middle, thickness_m.end());
  return *middle;
}

}  // namespace

Result<Surfaces> BuildSurfaces(const std::vector<RegisteredScan>& scans,
                               const SurfaceOptions& options, const ProgressCallback& progress) {
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  const Status cancelled = Status::Cancelled("building the surfaces was stopped on request");
  if (!ReportProgress(progress, kStage, 0.0)) return cancelled;
  Surfaces surfaces;
  for (const RegisteredScan& scan : scans) {
    surfaces.num_points_in += static_cast<int>(scan.points.size());
  }
  const std::vector<LidarReturn> points = CollectReturns(scans, options.min_range_m);
  if (points.empty()) {
    return Status::InsufficientData("no lidar return lies beyond " +
                                    std::to_string(options.min_range_m) +
                                    " m (surfaces.min_range_m): there is nothing to map");
  }
  std::vector<PointLabel> labels(points.size(), PointLabel::kStructure);
  surfaces.num_points_ground = SegmentGround(points, options.ground, &labels);
  if (!ReportProgress(progress, kStage, 0.1)) return cancelled;
  if (options.moving_objects.enabled) {
    surfaces.num_points_moving = RemoveMovingObjects(points, options.moving_objects, &labels);
  }
  if (!ReportProgress(progress, kStage, 0.3)) return cancelled;

  std::vector<Timestamp> stamps_ns;
  for (const RegisteredScan& scan : scans) stamps_ns.push_back(scan.stamp_ns);
  // Poisson keeps one core busy, the surfels take the others.
  tbb::parallel_invoke([&] { surfaces.ground = BuildGroundMesh(points, labels, options.ground); },
                       [&] {
                         surfaces.surfels = FitSurfels(points, labels, stamps_ns, options.surfels);
                         surfaces.points = ThinCloud(points, labels, options.map_voxel_size_m);
                       });
  if (surfaces.ground.triangles.empty() && surfaces.surfels.empty()) {
    return Status::InsufficientData("the lidar points form no surface: too few or too scattered");
  }
  surfaces.median_surfel_thickness_m = MedianPlanarThickness(surfaces.surfels);
  if (!ReportProgress(progress, kStage, 1.0)) return cancelled;
  return surfaces;
}

}  // namespace scenecalib
