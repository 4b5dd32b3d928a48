#include "scenecalib/simulation/simulator.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>
#include <tuple>
#include <utility>

#include "scenecalib/geometry/so3.h"
#include "scenecalib/simulation/camera_renderer.h"
#include "scenecalib/simulation/inertial.h"
#include "scenecalib/simulation/lidar_caster.h"
#include "scenecalib/simulation/own_vehicle.h"
#include "scenecalib/simulation/road_curve.h"
#include "scenecalib/simulation/scene_tracer.h"
#include "scenecalib/simulation/vehicle_motion.h"
#include "scenecalib/simulation/world.h"

namespace scenecalib {

namespace {

constexpr Timestamp kEpochNs = 1'700'000'000'000'000'000;  // any date will do
constexpr double kTrajectoryStepS = 0.0025;
constexpr double kRoadMarginM = 60.0;  // road behind the first pose and ahead of the last

/// Streams of random numbers, one for each part of the recording, so that an option of one part
/// does not change another.
enum Stream : std::uint64_t {
  kRoad,
  kWorld,
  kDrive,
  kClocks,
  kImu,
  kOdometry,
  kScan,
  kCamera,
  kStart,
  kLasers
};

Status CheckInputs(const Rig& rig, const SimulationOptions& options) {
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  SCENECALIB_RETURN_IF_ERROR(CheckWorldKind(options.world.kind));
  const std::string& drive = options.drive.kind;
  if (drive != "turns" && drive != "gentle" && drive != "straight") {
    return Status::InvalidArgument("drive.kind is '" + drive +
                                   "'; known are turns, gentle and straight");
  }
  if (options.lidar.lowest_ring_deg >= options.lidar.highest_ring_deg) {
    return Status::InvalidArgument("lidar.lowest_ring_deg must be below lidar.highest_ring_deg");
  }
  if (options.duration_s * options.lidar.rate_hz < 2.0) {
    return Status::InvalidArgument("duration_s is too short for two turns of the lidar");
  }
  for (const CameraConfig& camera : rig.cameras) {
    if (!camera.model) {
      return Status::InvalidArgument("camera '" + camera.name +
                                     "' has no intrinsics: give them in the rig file");
    }
  }
  return Status::Ok();
}

/// The vehicle frame (see VehicleMotion) for a rig that need not say where the ground is: level
/// with the odometry's body if there is one, otherwise with the lidar.
Rigid3 VehicleFromLidar(const Rig& rig, double lidar_height_m) {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  if (rig.odometry) rotation = rig.odometry->lidar_from_body.rotation.conjugate();
  return {rotation, {1.0, 0.0, lidar_height_m}};
}

double SignedHalfToFull(double limit, Random* random) {
  const double size = limit * random->Uniform(0.5, 1.0);
  return random->Uniform() < 0.5 ? -size : size;
}

Eigen::Vector3d PerturbationVector(double limit, Random* random) {
  const double x = SignedHalfToFull(limit, random);
  const double y = SignedHalfToFull(limit, random);
  const double z = SignedHalfToFull(limit, random);
  return {x, y, z};
}

}  // namespace

struct Simulator::Impl {
  Impl(const Rig& true_rig, const SimulationOptions& simulation_options)
      : rig(true_rig),
        options(simulation_options),
        random(static_cast<std::uint64_t>(simulation_options.seed)),
        vehicle_from_lidar(VehicleFromLidar(true_rig, simulation_options.lidar.height_m)),
        margin_s(1.5 / simulation_options.lidar.rate_hz),
        road(options.drive.kind, -kRoadMarginM - RoadLengthBefore(), RoadLengthAhead(),
             RoadLengthAhead() + kRoadMarginM, CornerRadius(options.world.kind),
             random.Fork(kRoad)),
        motion(road, options.drive, -margin_s, options.duration_s + margin_s, random.Fork(kDrive)),
        world(BuildWorld(options.world, road, options.drive.speed_m_s, random.Fork(kWorld))),
        lasers(MakeLasers(options.lidar, random.Fork(kLasers))),
        own_vehicle(MakeOwnVehicle(options.lidar.height_m)) {}

  double RoadLengthBefore() const { return (1.0 + margin_s) * options.drive.speed_m_s; }
  double RoadLengthAhead() const {
    return (options.duration_s + 1.0) * options.drive.speed_m_s * 1.1;
  }

  Status Prepare();
  void MakeSchedule();
  Status MakeTrajectory();
  double Time(Timestamp stamp_ns) const { return SecondsBetween(kEpochNs, stamp_ns); }
  bool Covers(Timestamp stamp_ns) const { return trajectory.Covers(stamp_ns); }
  Rigid3 MapFromLidar(Timestamp stamp_ns) const {
    return motion.MapFromVehicle(Time(stamp_ns)) * vehicle_from_lidar;
  }
  std::vector<Rigid3> ObjectPoses(Timestamp stamp_ns) const;
  std::optional<ScenePoint> Cast(Timestamp stamp_ns, const Eigen::Vector3d& origin,
                                 const Eigen::Vector3d& direction, bool sees_own) const;

  const Rig rig;
  const SimulationOptions options;
  const Random random;
  const Rigid3 vehicle_from_lidar;
  const double margin_s;
  const RoadCurve road;
  const VehicleMotion motion;
  World world;
  const std::vector<Laser> lasers;
  const OwnVehicle own_vehicle;
  std::unique_ptr<SceneTracer> tracer;
  std::vector<CameraRenderer> renderers;
  Trajectory trajectory;
  std::vector<ScheduledMeasurement> schedule;
  std::vector<Timestamp> scan_start_ns;
  std::vector<std::vector<Timestamp>> exposure_ns;  ///< per camera
  std::vector<ImuSample> imu;
  std::vector<OdometrySample> odometry;
};

Status Simulator::Impl::Prepare() {
  std::vector<Mesh> objects;
  for (MovingCar& car : world.cars) objects.push_back(std::move(car.mesh));
  objects.push_back(own_vehicle.mesh);
  Result<SceneTracer> created =
      SceneTracer::Create(std::move(world.mesh), world.shadow_mesh, std::move(objects));
  if (!created.ok()) return created.status();
  tracer = std::make_unique<SceneTracer>(std::move(*created));
  Sunlight sunlight;
  sunlight.towards_sun = world.towards_sun.cast<float>();
  sunlight.shadows = options.world.shadows;
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    const CameraConfig& camera = rig.cameras[i];
    const Rigid3 camera_from_vehicle =
        camera.lidar_from_camera.Inverse() * vehicle_from_lidar.Inverse();
    const bool outside = !own_vehicle.Contains(camera_from_vehicle.Inverse().translation);
    renderers.emplace_back(tracer.get(), camera.model, options.camera, sunlight,
                           camera_from_vehicle, outside, random.Fork(kCamera).Fork(i));
  }
  SCENECALIB_RETURN_IF_ERROR(MakeTrajectory());
  MakeSchedule();
  return Status::Ok();
}

Status Simulator::Impl::MakeTrajectory() {
  std::vector<TimedPose> poses;
  const double margin = 1.0 / options.lidar.rate_hz;
  const auto first = static_cast<std::int64_t>(std::floor(-margin / kTrajectoryStepS));
  const auto last =
      static_cast<std::int64_t>(std::ceil((options.duration_s + margin) / kTrajectoryStepS));
  for (std::int64_t i = first; i <= last; ++i) {
    const Timestamp stamp_ns = AddSeconds(kEpochNs, static_cast<double>(i) * kTrajectoryStepS);
    poses.push_back({stamp_ns, MapFromLidar(stamp_ns)});
  }
  Result<Trajectory> created = Trajectory::Create(std::move(poses));
  if (!created.ok()) return created.status();
  trajectory = std::move(*created);
  return Status::Ok();
}

void Simulator::Impl::MakeSchedule() {
  Random clocks = random.Fork(kClocks);
  // Stamps of a sensor: its own phase, its own idea of a second.
  const auto ticks = [&](double rate_hz, double rate_spread, double last_s) {
    const double step_s = 1.0 / (rate_hz * (1.0 + rate_spread * clocks.Uniform(-1.0, 1.0)));
    const double phase_s = std::min(step_s, 0.1) * clocks.Uniform();
    std::vector<Timestamp> stamps;
    for (int i = 0; phase_s + i * step_s <= last_s; ++i) {
      stamps.push_back(AddSeconds(kEpochNs, phase_s + i * step_s));
    }
    return stamps;
  };
  const double turn_s = 1.0 / options.lidar.rate_hz;
  scan_start_ns = ticks(options.lidar.rate_hz, 0.0, options.duration_s - turn_s);
  const auto add = [this](MeasurementKind kind, int camera, const std::vector<Timestamp>& stamps,
                          double clock_offset_s, double lasts_s) {
    for (std::size_t i = 0; i < stamps.size(); ++i) {
      schedule.push_back({kind, camera, static_cast<int>(i), AddSeconds(stamps[i], -clock_offset_s),
                          AddSeconds(stamps[i], lasts_s), stamps[i]});
    }
  };
  add(MeasurementKind::kScan, -1, scan_start_ns, 0.0, turn_s);
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    exposure_ns.push_back(
        ticks(options.camera.rate_hz, options.camera.clock_rate_spread, options.duration_s));
    const CameraConfig& camera = rig.cameras[i];
    const double read_out_s =
        camera.rolling_shutter_line_time_s.value_or(0.0) * (camera.model->height_px() - 1);
    add(MeasurementKind::kImage, static_cast<int>(i), exposure_ns.back(), camera.time_offset_s,
        std::max(0.0, read_out_s));
  }
  if (rig.imu) {
    const Rigid3 vehicle_from_imu = vehicle_from_lidar * rig.imu->lidar_from_imu;
    const auto stamps = ticks(options.imu.rate_hz, 0.0, options.duration_s);
    imu = SimulateImu(
        stamps, [this](Timestamp stamp_ns) { return motion.At(Time(stamp_ns)); }, vehicle_from_imu,
        options.imu, random.Fork(kImu));
    add(MeasurementKind::kImu, -1, stamps, 0.0, 0.0);
  }
  if (rig.odometry) {
    const Rigid3 lidar_from_body = rig.odometry->lidar_from_body;
    const auto stamps = ticks(options.odometry.rate_hz, 0.0, options.duration_s);
    odometry = SimulateOdometry(
        stamps,
        [this, lidar_from_body](Timestamp stamp_ns) {
          return MapFromLidar(stamp_ns) * lidar_from_body;
        },
        options.odometry, random.Fork(kOdometry));
    add(MeasurementKind::kOdometry, -1, stamps, 0.0, 0.0);
  }
  std::sort(schedule.begin(), schedule.end(), [](const auto& a, const auto& b) {
    return std::tie(a.arrival_ns, a.kind, a.camera, a.index) <
           std::tie(b.arrival_ns, b.kind, b.camera, b.index);
  });
}

std::vector<Rigid3> Simulator::Impl::ObjectPoses(Timestamp stamp_ns) const {
  std::vector<Rigid3> poses;
  for (const MovingCar& car : world.cars) {
    poses.push_back(MapFromCar(car, road, motion, Time(stamp_ns)));
  }
  poses.push_back(motion.MapFromVehicle(Time(stamp_ns)));
  return poses;
}

std::optional<ScenePoint> Simulator::Impl::Cast(Timestamp stamp_ns, const Eigen::Vector3d& origin,
                                                const Eigen::Vector3d& direction,
                                                bool sees_own) const {
  TraceOptions trace;
  trace.num_objects = tracer->num_objects() - (sees_own ? 0 : 1);
  const Eigen::Vector3f float_direction = direction.cast<float>();
  SceneHit hit;
  tracer->Trace(origin, &float_direction, 1, ObjectPoses(stamp_ns), trace, &hit);
  if (hit.object == SceneHit::kNone) return std::nullopt;
  ScenePoint point;
  point.range_m = hit.range_m;
  point.point_in_map_m = origin + point.range_m * direction;
  point.normal_in_map = hit.normal_in_map.cast<double>().normalized();
  point.object_id = tracer->SurfaceOf(hit).object_id;
  point.is_own_vehicle = hit.object == tracer->num_objects();
  point.is_moving = hit.object != SceneHit::kStatic && !point.is_own_vehicle;
  point.moving_object = hit.object - 1;
  return point;
}

Simulator::Simulator(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Simulator::~Simulator() = default;
Simulator::Simulator(Simulator&&) noexcept = default;
Simulator& Simulator::operator=(Simulator&&) noexcept = default;

Result<Simulator> Simulator::Create(const Rig& true_rig, const SimulationOptions& options) {
  SCENECALIB_RETURN_IF_ERROR(CheckInputs(true_rig, options));
  auto impl = std::make_unique<Impl>(true_rig, options);
  SCENECALIB_RETURN_IF_ERROR(impl->Prepare());
  return Simulator(std::move(impl));
}

const Rig& Simulator::true_rig() const { return impl_->rig; }
const Trajectory& Simulator::true_map_from_lidar() const { return impl_->trajectory; }
const std::vector<ScheduledMeasurement>& Simulator::schedule() const { return impl_->schedule; }
std::size_t Simulator::num_triangles() const { return impl_->tracer->num_triangles(); }
int Simulator::num_scans() const { return static_cast<int>(impl_->scan_start_ns.size()); }
int Simulator::num_images(int camera) const {
  return static_cast<int>(impl_->exposure_ns[static_cast<std::size_t>(camera)].size());
}

Result<Rig> Simulator::PerturbedRig() const {
  Random random = impl_->random.Fork(kStart);
  const SimulatedStartOptions& start = impl_->options.start;
  Rig rig = impl_->rig;
  for (CameraConfig& camera : rig.cameras) {
    const Eigen::Vector3d rotation_rad =
        PerturbationVector(start.rotation_deg * M_PI / 180.0, &random);
    const Eigen::Vector3d translation_m = PerturbationVector(start.translation_m, &random);
    camera.lidar_from_camera =
        camera.lidar_from_camera * Rigid3(ExpSo3(rotation_rad), translation_m);
    TunableIntrinsics tunable = camera.model->tunable();
    tunable.focal_scale *= 1.0 + SignedHalfToFull(start.focal_share, &random);
    tunable.principal_point_px.x() += SignedHalfToFull(start.principal_point_px, &random);
    tunable.principal_point_px.y() += SignedHalfToFull(start.principal_point_px, &random);
    Result<CameraModelPtr> model = camera.model->WithTunable(tunable);
    if (!model.ok()) {
      return Status::InvalidArgument("camera '" + camera.name +
                                     "': start is too far off: " + model.status().message());
    }
    camera.model = *model;
    camera.time_offset_s += SignedHalfToFull(start.time_offset_s, &random);
  }
  return rig;
}

std::optional<Rigid3> Simulator::MapFromLidar(Timestamp stamp_ns) const {
  if (!impl_->Covers(stamp_ns)) return std::nullopt;
  return impl_->MapFromLidar(stamp_ns);
}

LidarScan Simulator::CastScan(int index) const {
  const Impl& impl = *impl_;
  const bool outside = !impl.own_vehicle.Contains(impl.vehicle_from_lidar.translation);
  const std::uint64_t seed =
      impl.random.Fork(kScan).Fork(static_cast<std::uint64_t>(index)).NextBits();
  return CastLidarScan(
      *impl.tracer, impl.options.lidar, impl.lasers, outside,
      impl.scan_start_ns[static_cast<std::size_t>(index)], seed, [&impl](Timestamp stamp_ns) {
        return SceneInstant{impl.MapFromLidar(stamp_ns), impl.ObjectPoses(stamp_ns)};
      });
}

ImuSample Simulator::Imu(int index) const { return impl_->imu[static_cast<std::size_t>(index)]; }

OdometrySample Simulator::Odometry(int index) const {
  return impl_->odometry[static_cast<std::size_t>(index)];
}

cv::Mat Simulator::RenderImage(int camera, int index) const {
  const auto& exposures = impl_->exposure_ns[static_cast<std::size_t>(camera)];
  return RenderImageAt(camera, exposures[static_cast<std::size_t>(index)], index);
}

cv::Mat Simulator::RenderImageAt(int camera, Timestamp exposure_ns, int index) const {
  const Impl& impl = *impl_;
  const auto i = static_cast<std::size_t>(camera);
  RenderView view;
  const CameraConfig& config = impl.rig.cameras[i];
  const int num_instants = config.rolling_shutter_line_time_s ? config.model->height_px() : 1;
  for (int row = 0; row < num_instants; ++row) {
    const Timestamp row_ns = RowTime(camera, exposure_ns, row);
    view.instants.push_back(
        {impl.MapFromLidar(row_ns) * config.lidar_from_camera, impl.ObjectPoses(row_ns)});
  }
  Random random = impl.random.Fork(kCamera).Fork(1000 + i);
  const double phase_rad = random.Uniform(0.0, 2.0 * M_PI);
  view.noise_seed =
      static_cast<std::uint32_t>(random.Fork(static_cast<std::uint64_t>(index)).NextBits());
  // Automatic exposure: slow changes of some percent.
  const double breathing = 0.05 * std::sin(0.9 * impl.Time(exposure_ns) + phase_rad);
  view.exposure = static_cast<float>(std::exp(breathing));
  return impl.renderers[i].Render(view);
}

std::optional<ScenePoint> Simulator::TrueScenePoint(int camera, Timestamp exposure_ns,
                                                    const Eigen::Vector2d& pixel) const {
  const auto i = static_cast<std::size_t>(camera);
  const CameraConfig& config = impl_->rig.cameras[i];
  const auto ray = config.model->Unproject(pixel);
  const Timestamp row_ns = RowTime(camera, exposure_ns, pixel.y());
  if (!ray || !impl_->Covers(row_ns)) return std::nullopt;
  const double theta_rad = std::atan2(ray->head<2>().norm(), ray->z());
  if (theta_rad > impl_->options.camera.max_theta_deg * M_PI / 180.0) return std::nullopt;
  const Rigid3 map_from_camera = impl_->MapFromLidar(row_ns) * config.lidar_from_camera;
  return impl_->Cast(row_ns, map_from_camera.translation, map_from_camera.rotation * *ray,
                     impl_->renderers[i].sees_own_vehicle());
}

std::optional<Eigen::Vector2d> Simulator::TruePixel(int camera, Timestamp exposure_ns,
                                                    const Eigen::Vector3d& point_in_map_m) const {
  const CameraConfig& config = impl_->rig.cameras[static_cast<std::size_t>(camera)];
  // A row's time moves the pixel by a few percent of what the row moved: soon it stands still.
  constexpr int kMaxSteps = 10;
  double row_px = 0.5 * config.model->height_px();
  std::optional<Eigen::Vector2d> pixel;
  for (int step = 0; step < kMaxSteps; ++step) {
    const Timestamp row_ns = RowTime(camera, exposure_ns, row_px);
    if (!impl_->Covers(row_ns)) return std::nullopt;
    const Rigid3 map_from_camera = impl_->MapFromLidar(row_ns) * config.lidar_from_camera;
    pixel = config.model->ProjectTuned(map_from_camera.Inverse() * point_in_map_m,
                                       config.model->tunable(), nullptr);
    if (!pixel || !config.rolling_shutter_line_time_s) break;
    row_px = std::min(std::max(pixel->y(), -0.5), config.model->height_px() - 0.5);
  }
  if (!pixel || !config.model->IsInImage(*pixel)) return std::nullopt;
  return pixel;
}

Timestamp Simulator::RowTime(int camera, Timestamp exposure_ns, double row_px) const {
  const CameraConfig& config = impl_->rig.cameras[static_cast<std::size_t>(camera)];
  return AddSeconds(exposure_ns, config.rolling_shutter_line_time_s.value_or(0.0) * row_px);
}

std::optional<ScenePoint> Simulator::CastRay(Timestamp stamp_ns,
                                             const Eigen::Vector3d& origin_in_map_m,
                                             const Eigen::Vector3d& direction_in_map) const {
  if (!impl_->Covers(stamp_ns)) return std::nullopt;
  return impl_->Cast(stamp_ns, origin_in_map_m, direction_in_map, false);
}

std::optional<Eigen::Vector3d> Simulator::PointAtTime(const ScenePoint& point, Timestamp from_ns,
                                                      Timestamp to_ns) const {
  if (!impl_->Covers(from_ns) || !impl_->Covers(to_ns)) return std::nullopt;
  if (point.moving_object < 0) return point.point_in_map_m;
  const auto i = static_cast<std::size_t>(point.moving_object);
  const Rigid3 object_from_map = impl_->ObjectPoses(from_ns)[i].Inverse();
  return impl_->ObjectPoses(to_ns)[i] * (object_from_map * point.point_in_map_m);
}

}  // namespace scenecalib
