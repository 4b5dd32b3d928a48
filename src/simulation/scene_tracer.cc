#include "scenecalib/simulation/scene_tracer.h"

#include <embree3/rtcore.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <type_traits>
#include <utility>

#include "scenecalib/simulation/texture.h"

namespace scenecalib {

namespace {

struct DeviceDeleter {
  void operator()(RTCDevice device) const { rtcReleaseDevice(device); }
};
struct SceneDeleter {
  void operator()(RTCScene scene) const { rtcReleaseScene(scene); }
};
using DevicePtr = std::unique_ptr<std::remove_pointer_t<RTCDevice>, DeviceDeleter>;
using ScenePtr = std::unique_ptr<std::remove_pointer_t<RTCScene>, SceneDeleter>;

constexpr float kShadowOffset = 2e-3F;  // metres off the surface, against shadowing itself

/// Adds the triangles that `keep` accepts; their ids are those of the accepted ones, in order.
template <typename Keep>
void AttachMesh(RTCDevice device, RTCScene scene, const Mesh& mesh, const Keep& keep) {
  std::vector<std::size_t> kept;
  for (std::size_t i = 0; i < mesh.num_triangles(); ++i) {
    if (keep(i)) kept.push_back(i);
  }
  if (kept.empty()) return;
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(
      geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), 3 * kept.size()));
  auto* indices = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
      geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned), kept.size()));
  for (std::size_t i = 0; i < kept.size(); ++i) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const Eigen::Vector3f& p = mesh.vertices()[3 * kept[i] + corner];
      for (int axis = 0; axis < 3; ++axis) vertices[9 * i + 3 * corner + axis] = p[axis];
      indices[3 * i + corner] = static_cast<unsigned>(3 * i + corner);
    }
  }
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(scene, geometry);
  rtcReleaseGeometry(geometry);
}

/// With one building thread: the tree, and so which of two equally near triangles is met, does not
/// depend on the machine's threads. The device's own number of threads would bind the whole
/// process.
void CommitScene(RTCScene scene) {
  tbb::task_arena one(1);
  one.execute([scene] { rtcCommitScene(scene); });
}

ScenePtr NewScene(RTCDevice device) {
  ScenePtr scene(rtcNewScene(device));
  rtcSetSceneFlags(scene.get(), RTC_SCENE_FLAG_ROBUST);
  rtcSetSceneBuildQuality(scene.get(), RTC_BUILD_QUALITY_MEDIUM);
  return scene;
}

void SetRay(const Eigen::Vector3f& origin, const Eigen::Vector3f& direction, float max_range_m,
            RTCRay* ray) {
  ray->org_x = origin.x();
  ray->org_y = origin.y();
  ray->org_z = origin.z();
  ray->dir_x = direction.x();
  ray->dir_y = direction.y();
  ray->dir_z = direction.z();
  ray->tnear = 0.0F;
  ray->tfar = max_range_m;
  ray->time = 0.0F;
  ray->mask = 0xffffffffU;
  ray->id = 0;
  ray->flags = 0;
}

/// A moving object, with a sphere around it.
struct MovingMesh {
  Mesh mesh;
  ScenePtr scene;
  Eigen::Vector3d centre_m = Eigen::Vector3d::Zero();
  float radius_m = 0.0F;
};

void FindSphere(MovingMesh* object) {
  const auto& vertices = object->mesh.vertices();
  if (vertices.empty()) return;
  Eigen::Vector3f low = vertices.front();
  Eigen::Vector3f high = low;
  for (const Eigen::Vector3f& p : vertices) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  object->centre_m = 0.5 * (low + high).cast<double>();
  object->radius_m = 0.5F * (high - low).norm() + 0.01F;
}

bool MeetsSphere(const Eigen::Vector3f& to_centre, const Eigen::Vector3f& direction,
                 float radius_m) {
  const float along = to_centre.dot(direction);
  const float distance2 = to_centre.squaredNorm();
  if (distance2 <= radius_m * radius_m) return true;
  return along > 0.0F && distance2 - along * along <= radius_m * radius_m;
}

Eigen::Vector3f UnitAgainst(const Eigen::Vector3f& normal, const Eigen::Vector3f& direction) {
  const Eigen::Vector3f unit = normal.normalized();
  return unit.dot(direction) > 0.0F ? Eigen::Vector3f(-unit) : unit;
}

RTCIntersectContext NewContext(bool coherent) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags =
      coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
  return context;
}

}  // namespace

struct SceneTracer::Impl {
  DevicePtr device;  // before the scenes: outlives them
  Mesh world;
  ScenePtr scene;
  ScenePtr shadow_scene;
  std::vector<MovingMesh> objects;

  const Mesh& MeshOf(const SceneHit& hit) const {
    return hit.object == SceneHit::kStatic ? world
                                           : objects[static_cast<std::size_t>(hit.object - 1)].mesh;
  }

  void TraceObject(std::size_t i, const Eigen::Vector3d& origin, const Eigen::Vector3f* directions,
                   std::size_t num_rays, const Rigid3& map_from_object, SceneHit* hits) const;
};

SceneTracer::SceneTracer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SceneTracer::~SceneTracer() = default;
SceneTracer::SceneTracer(SceneTracer&&) noexcept = default;
SceneTracer& SceneTracer::operator=(SceneTracer&&) noexcept = default;

Result<SceneTracer> SceneTracer::Create(Mesh world, const Mesh& shadow_mesh,
                                        std::vector<Mesh> objects) {
  auto impl = std::make_unique<Impl>();
  impl->device.reset(rtcNewDevice(nullptr));
  if (!impl->device) return Status::Unavailable("Embree cannot open its device");
  RTCDevice device = impl->device.get();
  impl->world = std::move(world);
  impl->scene = NewScene(device);
  const auto all = [](std::size_t) { return true; };
  AttachMesh(device, impl->scene.get(), impl->world, all);
  CommitScene(impl->scene.get());
  impl->shadow_scene = NewScene(device);
  const Mesh& mesh = impl->world;
  AttachMesh(device, impl->shadow_scene.get(), mesh, [&mesh](std::size_t i) {
    return mesh.surfaces()[mesh.textures()[i].surface].material != Material::kLeaves;
  });
  AttachMesh(device, impl->shadow_scene.get(), shadow_mesh, all);
  CommitScene(impl->shadow_scene.get());
  for (Mesh& object : objects) {
    MovingMesh moving;
    moving.mesh = std::move(object);
    moving.scene = NewScene(device);
    AttachMesh(device, moving.scene.get(), moving.mesh, all);
    CommitScene(moving.scene.get());
    FindSphere(&moving);
    impl->objects.push_back(std::move(moving));
  }
  if (rtcGetDeviceError(device) != RTC_ERROR_NONE) {
    return Status::Unavailable("Embree could not build the simulated world");
  }
  return SceneTracer(std::move(impl));
}

int SceneTracer::num_objects() const { return static_cast<int>(impl_->objects.size()); }
std::size_t SceneTracer::num_triangles() const { return impl_->world.num_triangles(); }

void SceneTracer::Trace(const Eigen::Vector3d& origin, const Eigen::Vector3f* directions,
                        std::size_t num_rays, const std::vector<Rigid3>& map_from_object,
                        const TraceOptions& options, SceneHit* hits) const {
  thread_local std::vector<RTCRayHit> queries;
  queries.resize(num_rays);
  const Eigen::Vector3f float_origin = origin.cast<float>();
  for (std::size_t i = 0; i < num_rays; ++i) {
    SetRay(float_origin, directions[i], options.max_range_m, &queries[i].ray);
    queries[i].hit.geomID = RTC_INVALID_GEOMETRY_ID;
    queries[i].hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  }
  RTCIntersectContext context = NewContext(options.coherent);
  rtcIntersect1M(impl_->scene.get(), &context, queries.data(), static_cast<unsigned>(num_rays),
                 sizeof(RTCRayHit));
  for (std::size_t i = 0; i < num_rays; ++i) {
    const RTCRayHit& query = queries[i];
    SceneHit& hit = hits[i];
    hit = SceneHit();
    hit.range_m = options.max_range_m;
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) continue;
    hit.object = SceneHit::kStatic;
    hit.triangle = query.hit.primID;
    hit.range_m = query.ray.tfar;
    hit.u = query.hit.u;
    hit.v = query.hit.v;
    hit.normal_in_map =
        UnitAgainst({query.hit.Ng_x, query.hit.Ng_y, query.hit.Ng_z}, directions[i]);
  }
  for (std::size_t k = 0; k < static_cast<std::size_t>(options.num_objects); ++k) {
    impl_->TraceObject(k, origin, directions, num_rays, map_from_object[k], hits);
  }
}

void SceneTracer::Impl::TraceObject(std::size_t index, const Eigen::Vector3d& origin,
                                    const Eigen::Vector3f* directions, std::size_t num_rays,
                                    const Rigid3& map_from_object, SceneHit* hits) const {
  const MovingMesh& object = objects[index];
  const Eigen::Vector3f to_centre = (map_from_object * object.centre_m - origin).cast<float>();
  const Eigen::Matrix3f map_from_object_rotation = map_from_object.RotationMatrix().cast<float>();
  const Eigen::Vector3f origin_in_object = (map_from_object.Inverse() * origin).cast<float>();
  RTCIntersectContext context = NewContext(false);
  for (std::size_t i = 0; i < num_rays; ++i) {
    if (!MeetsSphere(to_centre, directions[i], object.radius_m)) continue;
    RTCRayHit query;
    SetRay(origin_in_object, map_from_object_rotation.transpose() * directions[i], hits[i].range_m,
           &query.ray);
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(object.scene.get(), &context, &query);
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) continue;
    SceneHit& hit = hits[i];
    hit.object = static_cast<std::int32_t>(index) + 1;
    hit.triangle = query.hit.primID;
    hit.range_m = query.ray.tfar;
    hit.u = query.hit.u;
    hit.v = query.hit.v;
    hit.normal_in_map = UnitAgainst(
        map_from_object_rotation * Eigen::Vector3f(query.hit.Ng_x, query.hit.Ng_y, query.hit.Ng_z),
        directions[i]);
  }
}

void SceneTracer::TraceSun(const Eigen::Vector3f* points, std::size_t num_points,
                           const Eigen::Vector3f& towards_sun,
                           const std::vector<Rigid3>& map_from_object, bool* lit) const {
  constexpr float kFar = 300.0F;
  thread_local std::vector<RTCRay> rays;
  rays.resize(num_points);
  for (std::size_t i = 0; i < num_points; ++i) {
    SetRay(points[i], towards_sun, kFar, &rays[i]);
    rays[i].tnear = kShadowOffset;
  }
  RTCIntersectContext context = NewContext(true);
  rtcOccluded1M(impl_->shadow_scene.get(), &context, rays.data(), static_cast<unsigned>(num_points),
                sizeof(RTCRay));
  for (std::size_t i = 0; i < num_points; ++i) lit[i] = rays[i].tfar >= 0.0F;
  RTCIntersectContext single = NewContext(false);
  for (std::size_t k = 0; k < impl_->objects.size(); ++k) {
    const MovingMesh& object = impl_->objects[k];
    const Rigid3& pose = map_from_object[k];
    const Eigen::Vector3f centre = (pose * object.centre_m).cast<float>();
    const Rigid3 object_from_map = pose.Inverse();
    for (std::size_t i = 0; i < num_points; ++i) {
      if (!lit[i] || !MeetsSphere(centre - points[i], towards_sun, object.radius_m)) continue;
      RTCRay ray;
      SetRay((object_from_map * points[i].cast<double>()).cast<float>(),
             (object_from_map.rotation * towards_sun.cast<double>()).cast<float>(), kFar, &ray);
      ray.tnear = kShadowOffset;
      rtcOccluded1(object.scene.get(), &single, &ray);
      lit[i] = ray.tfar >= 0.0F;
    }
  }
}

const Surface& SceneTracer::SurfaceOf(const SceneHit& hit) const {
  const Mesh& mesh = impl_->MeshOf(hit);
  return mesh.surfaces()[mesh.textures()[hit.triangle].surface];
}

Eigen::Vector3f SceneTracer::Albedo(const SceneHit& hit, const Eigen::Vector3f& direction,
                                    const Eigen::Vector3f& ray_dx, const Eigen::Vector3f& ray_dy,
                                    const std::vector<Rigid3>& map_from_object) const {
  const Mesh& mesh = impl_->MeshOf(hit);
  const TriangleTexture& texture = mesh.textures()[hit.triangle];
  // Ray differentials (Igehy 1999): how the point on the surface moves from pixel to pixel.
  const float facing = std::min(hit.normal_in_map.dot(direction), -1e-3F);
  const auto on_surface = [&](const Eigen::Vector3f& step) {
    return Eigen::Vector3f(hit.range_m *
                           (step - direction * (hit.normal_in_map.dot(step) / facing)));
  };
  Eigen::Vector3f u_gradient = texture.u_gradient;
  Eigen::Vector3f v_gradient = texture.v_gradient;
  if (hit.object != SceneHit::kStatic) {
    const Eigen::Quaternionf rotation =
        map_from_object[static_cast<std::size_t>(hit.object - 1)].rotation.cast<float>();
    u_gradient = rotation * u_gradient;
    v_gradient = rotation * v_gradient;
  }
  const Eigen::Vector3f dx = on_surface(ray_dx);
  const Eigen::Vector3f dy = on_surface(ray_dy);
  const Eigen::Vector2f footprint(std::hypot(u_gradient.dot(dx), u_gradient.dot(dy)),
                                  std::hypot(v_gradient.dot(dx), v_gradient.dot(dy)));
  const Eigen::Vector2f uv =
      (1.0F - hit.u - hit.v) * texture.uv[0] + hit.u * texture.uv[1] + hit.v * texture.uv[2];
  return EvaluateTexture(mesh.surfaces()[texture.surface], uv, footprint.cwiseMax(1e-4F));
}

}  // namespace scenecalib
