#include "scenecalib/mapping/ray_caster.h"

#include <embree3/rtcore.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>

#include "mesh_planes.h"

namespace scenecalib {
namespace {

/// Rays more oblique to their plane than this keep Embree's range: the intersection with the plane
/// is then worse than single precision.
constexpr double kMinCosine = 1e-3;

constexpr std::size_t kRaysPerPacket = 8;  ///< rtcIntersect8
constexpr std::size_t kRaysPerTask = 64 * kRaysPerPacket;

/// Rays are cast in the order of where they start and point to, so that neighbours walk through the
/// same part of the tree, eight at a time: a random order spends three quarters of its time waiting
/// for memory.
/// Edge of the cells that origins fall into, and bits per axis of the (octahedral) direction.
constexpr double kOriginCell_m = 16.0;
constexpr int kDirectionBits = 6;
/// Fewer rays than this are not worth sorting.
constexpr std::size_t kMinRaysToSort = 1024;

void Prefetch(const void* first, std::size_t size) {
  constexpr std::size_t kCacheLine = 64;
  for (std::size_t offset = 0; offset < size; offset += kCacheLine) {
    __builtin_prefetch(static_cast<const char*>(first) + offset);
  }
}

/// Bits of the lower half of a word spread over its even places (Morton order).
std::uint32_t SpreadBits(std::uint32_t value) {
  value &= 0xFFFFU;
  value = (value | (value << 8)) & 0x00FF00FFU;
  value = (value | (value << 4)) & 0x0F0F0F0FU;
  value = (value | (value << 2)) & 0x33333333U;
  return (value | (value << 1)) & 0x55555555U;
}

std::uint32_t Interleave(std::uint32_t x, std::uint32_t y) {
  return SpreadBits(x) | (SpreadBits(y) << 1);
}

/// Like rays have near keys: 20 bits of the origin's place (16 km square, then they repeat), 12 of
/// the direction on the unfolded octahedron (Meyer et al. 2010).
std::uint32_t CoherenceKey(const Ray& ray) {
  const auto cell = [](double coordinate_m) {
    return static_cast<std::uint32_t>(
               static_cast<std::int64_t>(std::floor(coordinate_m / kOriginCell_m))) &
           0x3FFU;
  };
  const Eigen::Vector3d& d = ray.direction_in_map;
  const double length = std::max(d.lpNorm<1>(), std::numeric_limits<double>::min());
  double u = d.x() / length;
  double v = d.y() / length;
  if (d.z() < 0.0) {
    const double folded_u = std::copysign(1.0 - std::abs(v), u);
    v = std::copysign(1.0 - std::abs(u), v);
    u = folded_u;
  }
  constexpr double kMax = (1 << kDirectionBits) - 1;
  const auto step = [&](double w) {
    return static_cast<std::uint32_t>(std::clamp(0.5 + 0.5 * w, 0.0, 1.0) * kMax);
  };
  return (Interleave(cell(ray.origin_in_map_m.x()), cell(ray.origin_in_map_m.y()))
          << (2 * kDirectionBits)) |
         Interleave(step(u), step(v));
}

/// The rays' indices in the order in which to cast them.
std::vector<std::uint64_t> CoherentOrder(const std::vector<Ray>& rays) {
  std::vector<std::uint64_t> order(rays.size());
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, rays.size(), 4 * kRaysPerTask),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t i = range.begin(); i != range.end(); ++i) {
                        order[i] = (static_cast<std::uint64_t>(CoherenceKey(rays[i])) << 32) | i;
                      }
                    });
  tbb::parallel_sort(order.begin(), order.end());
  for (std::uint64_t& entry : order) entry &= 0xFFFFFFFFU;
  return order;
}

constexpr int kCorners = 4;  ///< of a quad

struct DeviceRelease {
  void operator()(RTCDevice device) const { rtcReleaseDevice(device); }
};
struct SceneRelease {
  void operator()(RTCScene scene) const { rtcReleaseScene(scene); }
};
using DevicePtr = std::unique_ptr<RTCDeviceTy, DeviceRelease>;
using ScenePtr = std::unique_ptr<RTCSceneTy, SceneRelease>;

/// As quads whose last two corners are one: Embree then keeps them in one tree with the surfels.
void AttachGround(RTCDevice device, RTCScene scene, unsigned geometry_id,
                  const TriangleMesh& mesh) {
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_QUAD);
  auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0,
                                                               RTC_FORMAT_FLOAT3, 3 * sizeof(float),
                                                               mesh.vertices_m.size()));
  for (std::size_t i = 0; i < mesh.vertices_m.size(); ++i) {
    Eigen::Map<Eigen::Vector3f>(vertices + 3 * i) = mesh.vertices_m[i];
  }
  auto* indices = static_cast<unsigned*>(
      rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT4,
                              kCorners * sizeof(unsigned), mesh.triangles.size()));
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
    for (int k = 0; k < kCorners; ++k) {
      indices[kCorners * i + k] = static_cast<unsigned>(mesh.triangles[i][std::min(k, 2)]);
    }
  }
  rtcCommitGeometry(geometry);
  rtcAttachGeometryByID(scene, geometry, geometry_id);
  rtcReleaseGeometry(geometry);
}

/// Discs are cast at as quads, whose bounding boxes fit where Embree's own discs take a cube: what
/// lies outside of the inscribed circle is no hit.
void KeepInscribedDisc(const RTCFilterFunctionNArguments* arguments) {
  for (unsigned i = 0; i < arguments->N; ++i) {
    if (arguments->valid[i] == 0) continue;
    const float u = RTCHitN_u(arguments->hit, arguments->N, i) - 0.5F;
    const float v = RTCHitN_v(arguments->hit, arguments->N, i) - 0.5F;
    if (u * u + v * v > 0.25F) arguments->valid[i] = 0;
  }
}

void AttachSurfels(RTCDevice device, RTCScene scene, unsigned geometry_id,
                   const std::vector<Surfel>& surfels) {
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_QUAD);
  auto* corners = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0,
                                                              RTC_FORMAT_FLOAT3, 3 * sizeof(float),
                                                              kCorners * surfels.size()));
  auto* indices = static_cast<unsigned*>(
      rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT4,
                              kCorners * sizeof(unsigned), surfels.size()));
  for (std::size_t i = 0; i < surfels.size(); ++i) {
    const Eigen::Vector3f& n = surfels[i].normal;
    const Eigen::Vector3f across = (std::abs(n.z()) < 0.9F ? Eigen::Vector3f(-n.y(), n.x(), 0.0F)
                                                           : Eigen::Vector3f(0.0F, -n.z(), n.y()))
                                       .normalized();
    const Eigen::Vector3f u = surfels[i].radius_m * across;
    const Eigen::Vector3f v = surfels[i].radius_m * n.normalized().cross(across);
    const Eigen::Vector3f& c = surfels[i].center_m;
    float* const corner = corners + 3 * kCorners * i;
    Eigen::Map<Eigen::Vector3f>(corner + 0) = c - u - v;
    Eigen::Map<Eigen::Vector3f>(corner + 3) = c + u - v;
    Eigen::Map<Eigen::Vector3f>(corner + 6) = c + u + v;
    Eigen::Map<Eigen::Vector3f>(corner + 9) = c - u + v;
    for (int k = 0; k < kCorners; ++k) {
      indices[kCorners * i + k] = static_cast<unsigned>(kCorners * i + k);
    }
  }
  rtcSetGeometryIntersectFilterFunction(geometry, KeepInscribedDisc);
  rtcCommitGeometry(geometry);
  rtcAttachGeometryByID(scene, geometry, geometry_id);
  rtcReleaseGeometry(geometry);
}

}  // namespace

struct RayCaster::Impl {
  static constexpr unsigned kGroundId = 0;
  static constexpr unsigned kSurfelId = 1;

  DevicePtr device;
  ScenePtr scene;
  std::vector<MeshPlane> ground_planes;  ///< one per triangle
  std::vector<Surfel> surfels;

  std::optional<RayHit> Cast(const Ray& ray, double max_range_m) const;
  /// The rays order[0..count), count at most kRaysPerPacket, into their places among the hits.
  void CastPacket(const std::vector<Ray>& rays, const std::uint64_t* order, std::size_t count,
                  double max_range_m, std::vector<std::optional<RayHit>>* hits) const;
  RayHit Describe(const Ray& ray, double range_m, unsigned geometry_id, unsigned primitive) const;
};

RayHit RayCaster::Impl::Describe(const Ray& ray, double range_m, unsigned geometry_id,
                                 unsigned primitive) const {
  RayHit hit;
  hit.index = static_cast<int>(primitive);
  Eigen::Vector3d point_on_plane;
  double trusted_extent_m = 0.0;
  if (geometry_id == kGroundId) {
    const MeshPlane& plane = ground_planes[primitive];
    hit.kind = SurfaceKind::kGround;
    hit.normal_in_map = plane.normal;
    hit.scale_m = plane.scale_m;
    hit.thickness_m = plane.thickness_m;
    hit.planar = plane.planar;
    point_on_plane = plane.point_m;
    trusted_extent_m = plane.scale_m;
  } else {
    const Surfel& surfel = surfels[primitive];
    hit.kind = SurfaceKind::kSurfel;
    hit.normal_in_map = surfel.normal.cast<double>().normalized();
    hit.scale_m = surfel.scale_m;
    hit.thickness_m = surfel.thickness_m;
    hit.planar = surfel.planar;
    point_on_plane = surfel.center_m.cast<double>();
    trusted_extent_m = surfel.radius_m;
  }
  const double cosine = ray.direction_in_map.dot(hit.normal_in_map);
  hit.range_m = range_m;
  if (std::abs(cosine) > kMinCosine) {
    // Double precision on the fitted plane; a plane that would move the hit far along a grazing
    // ray is not the surface that was met there.
    const double range_on_plane_m =
        (point_on_plane - ray.origin_in_map_m).dot(hit.normal_in_map) / cosine;
    if (range_on_plane_m > 0.0 && std::abs(range_on_plane_m - range_m) < trusted_extent_m) {
      hit.range_m = range_on_plane_m;
    }
  }
  if (cosine > 0.0) hit.normal_in_map = -hit.normal_in_map;
  hit.incidence_angle_rad = std::acos(std::min(1.0, std::abs(cosine)));
  hit.point_in_map_m = ray.origin_in_map_m + hit.range_m * ray.direction_in_map;
  return hit;
}

std::optional<RayHit> RayCaster::Impl::Cast(const Ray& ray, double max_range_m) const {
  RTCRayHit query{};
  query.ray.org_x = static_cast<float>(ray.origin_in_map_m.x());
  query.ray.org_y = static_cast<float>(ray.origin_in_map_m.y());
  query.ray.org_z = static_cast<float>(ray.origin_in_map_m.z());
  query.ray.dir_x = static_cast<float>(ray.direction_in_map.x());
  query.ray.dir_y = static_cast<float>(ray.direction_in_map.y());
  query.ray.dir_z = static_cast<float>(ray.direction_in_map.z());
  query.ray.tnear = 0.0F;
  query.ray.tfar = static_cast<float>(max_range_m);
  query.ray.mask = 0xFFFFFFFFU;
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(scene.get(), &context, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  return Describe(ray, query.ray.tfar, query.hit.geomID, query.hit.primID);
}

void RayCaster::Impl::CastPacket(const std::vector<Ray>& rays, const std::uint64_t* order,
                                 std::size_t count, double max_range_m,
                                 std::vector<std::optional<RayHit>>* hits) const {
  constexpr std::size_t kAlignment = 4 * kRaysPerPacket;
  alignas(kAlignment) RTCRayHit8 query{};
  alignas(kAlignment) std::array<int, kRaysPerPacket> valid{};
  for (std::size_t j = 0; j < count; ++j) {
    const Ray& ray = rays[order[j]];
    valid[j] = -1;
    query.ray.org_x[j] = static_cast<float>(ray.origin_in_map_m.x());
    query.ray.org_y[j] = static_cast<float>(ray.origin_in_map_m.y());
    query.ray.org_z[j] = static_cast<float>(ray.origin_in_map_m.z());
    query.ray.dir_x[j] = static_cast<float>(ray.direction_in_map.x());
    query.ray.dir_y[j] = static_cast<float>(ray.direction_in_map.y());
    query.ray.dir_z[j] = static_cast<float>(ray.direction_in_map.z());
    query.ray.tfar[j] = static_cast<float>(max_range_m);
    query.ray.mask[j] = 0xFFFFFFFFU;
    query.hit.geomID[j] = RTC_INVALID_GEOMETRY_ID;
  }
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect8(valid.data(), scene.get(), &context, &query);
  for (std::size_t j = 0; j < count; ++j) {
    if (query.hit.geomID[j] == kGroundId) {
      Prefetch(&ground_planes[query.hit.primID[j]], sizeof(MeshPlane));
    } else if (query.hit.geomID[j] == kSurfelId) {
      Prefetch(&surfels[query.hit.primID[j]], sizeof(Surfel));
    }
  }
  for (std::size_t j = 0; j < count; ++j) {
    if (query.hit.geomID[j] == RTC_INVALID_GEOMETRY_ID) continue;
    (*hits)[order[j]] =
        Describe(rays[order[j]], query.ray.tfar[j], query.hit.geomID[j], query.hit.primID[j]);
  }
}

RayCaster::RayCaster(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RayCaster::RayCaster(RayCaster&&) noexcept = default;
RayCaster& RayCaster::operator=(RayCaster&&) noexcept = default;
RayCaster::~RayCaster() = default;

Result<RayCaster> RayCaster::Create(const SceneMap& map) {
  if (map.ground.triangles.empty() && map.surfels.empty()) {
    return Status::InsufficientData(
        "the map has neither ground nor surfels: there is nothing for image rays to meet");
  }
  auto impl = std::make_unique<Impl>();
  impl->device.reset(rtcNewDevice(nullptr));
  if (!impl->device) return Status::Unavailable("Embree cannot be initialised on this machine");
  impl->scene.reset(rtcNewScene(impl->device.get()));
  rtcSetSceneFlags(impl->scene.get(), RTC_SCENE_FLAG_ROBUST);
  if (!map.ground.triangles.empty()) {
    AttachGround(impl->device.get(), impl->scene.get(), Impl::kGroundId, map.ground);
    impl->ground_planes = FitMeshPlanes(map.ground);
  }
  if (!map.surfels.empty()) {
    AttachSurfels(impl->device.get(), impl->scene.get(), Impl::kSurfelId, map.surfels);
    impl->surfels = map.surfels;
  }
  rtcCommitScene(impl->scene.get());
  if (rtcGetDeviceError(impl->device.get()) != RTC_ERROR_NONE) {
    return Status::Unavailable("Embree could not build the ray-casting scene (out of memory?)");
  }
  return RayCaster(std::move(impl));
}

std::optional<RayHit> RayCaster::Cast(const Ray& ray, double max_range_m) const {
  return impl_->Cast(ray, max_range_m);
}

std::vector<std::optional<RayHit>> RayCaster::Cast(const std::vector<Ray>& rays,
                                                   double max_range_m) const {
  std::vector<std::optional<RayHit>> hits(rays.size());
  if (rays.size() < kMinRaysToSort) {
    tbb::parallel_for(std::size_t{0}, rays.size(),
                      [&](std::size_t i) { hits[i] = impl_->Cast(rays[i], max_range_m); });
    return hits;
  }
  const std::vector<std::uint64_t> order = CoherentOrder(rays);
  // Packets begin at fixed places, whatever the threads: a ray's company may decide which of two
  // surfaces that touch it meets.
  const std::size_t num_tasks = (rays.size() + kRaysPerTask - 1) / kRaysPerTask;
  tbb::parallel_for(std::size_t{0}, num_tasks, [&](std::size_t task) {
    const std::size_t end = std::min(rays.size(), (task + 1) * kRaysPerTask);
    for (std::size_t k = task * kRaysPerTask; k < end; k += kRaysPerPacket) {
      for (std::size_t ahead = k + kRaysPerPacket; ahead < std::min(end, k + 2 * kRaysPerPacket);
           ++ahead) {
        Prefetch(&rays[order[ahead]], sizeof(Ray));
        Prefetch(&hits[order[ahead]], sizeof(hits[0]));
      }
      impl_->CastPacket(rays, &order[k], std::min(kRaysPerPacket, end - k), max_range_m, &hits);
    }
  });
  return hits;
}

}  // namespace scenecalib
