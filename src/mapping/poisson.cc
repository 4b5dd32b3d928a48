#include "poisson.h"

#include <pcl/pcl_config.h>
#include <pcl/point_types.h>
#include <pcl/surface/poisson.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <mutex>

namespace scenecalib {
namespace {

constexpr float kBoxScale = 1.1F;  ///< of the octree's cube about the samples' box
/// Leaves of at least this depth everywhere. PCL's 5 costs half of the time in a flat tile, most of
/// whose cube is empty, and changes nothing near the data.
constexpr int kMinDepth = 3;
constexpr int kMaxDepth = 11;

std::mutex& PoissonMutex() {
  static std::mutex mutex;
  return mutex;
}

/// Octree depth at which the leaves of a cube around the samples are at most cell_m.
int DepthFor(const std::vector<GroundSample>& samples, double cell_m) {
  Eigen::AlignedBox3f box;
  for (const GroundSample& sample : samples) box.extend(sample.position_m);
  const double leaves = kBoxScale * box.sizes().maxCoeff() / cell_m;
  return std::clamp(static_cast<int>(std::ceil(std::log2(std::max(1.0, leaves)))), kMinDepth,
                    kMaxDepth);
}

}  // namespace

TriangleMesh PoissonSurface(const std::vector<GroundSample>& samples, double cell_m,
                            double point_weight) {
  // Single precision inside: the tile's own origin keeps the heights exact far from the map's.
  const Eigen::Vector3f origin_m = samples.front().position_m;
  auto cloud = pcl::PointCloud<pcl::PointNormal>::Ptr(new pcl::PointCloud<pcl::PointNormal>());
  cloud->reserve(samples.size());
  for (const GroundSample& sample : samples) {
    pcl::PointNormal point;
    point.getVector3fMap() = sample.position_m - origin_m;
    point.getNormalVector3fMap() = sample.normal;
    cloud->push_back(point);
  }
  pcl::Poisson<pcl::PointNormal> poisson;
  const int depth = DepthFor(samples, cell_m);
  poisson.setDepth(depth);
  poisson.setMinDepth(kMinDepth);
  poisson.setIsoDivide(std::max(kMinDepth, depth));
  poisson.setSolverDivide(std::max(kMinDepth, depth));
  poisson.setScale(kBoxScale);
  poisson.setPointWeight(static_cast<float>(point_weight));
  poisson.setInputCloud(cloud);
#if PCL_VERSION_COMPARE(>=, 1, 12, 0)
  poisson.setThreads(1);  // its OpenMP loops spin when the other cores are busy
#endif
  pcl::PointCloud<pcl::PointNormal> vertices;
  std::vector<pcl::Vertices> polygons;
  {
    const std::lock_guard<std::mutex> lock(PoissonMutex());
    poisson.reconstruct(vertices, polygons);
  }
  TriangleMesh mesh;
  mesh.vertices_m.reserve(vertices.size());
  for (const pcl::PointNormal& vertex : vertices) {
    mesh.vertices_m.push_back(vertex.getVector3fMap() + origin_m);
  }
  for (const pcl::Vertices& polygon : polygons) {
    if (polygon.vertices.size() != 3) continue;
    std::array<int, 3> triangle;
    for (int k = 0; k < 3; ++k) triangle[k] = static_cast<int>(polygon.vertices[k]);
    mesh.triangles.push_back(triangle);
  }
  return mesh;
}

}  // namespace scenecalib
