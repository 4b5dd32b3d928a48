// Accuracy of the surfaces against the simulator's exact truth: points and normals of ground and
// surfels, and the rays of the rig's pixels as association casts them.

#include <CLI/CLI.hpp>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "bench/lidar_arguments.h"
#include "bench/quantile.h"
#include "bench/simulated_drive.h"
#include "scenecalib/association/track_association.h"
#include "scenecalib/base/random.h"
#include "scenecalib/mapping/ray_caster.h"
#include "scenecalib/mapping/segment_mapper.h"

namespace scenecalib {
namespace {

constexpr double kDegrees = 180.0 / M_PI;
/// A surface whose truth is farther off than this is grossly wrong.
constexpr double kGross_m = 0.1;
/// Points of the mesh that are compared, per square metre.
constexpr double kSamplesPerArea = 25.0;
/// The truth of a point is sought this far on both sides of it.
constexpr double kSearch_m = 0.3;

struct Arguments {
  std::vector<std::string> worlds = {"street", "suburb", "plaza"};
  std::vector<int> seeds = {1};
  DriveSpec drive;
  bool true_trajectory = false;
  int pixel_step = 12;
  int image_step = 6;
  std::string rays_csv;
};

/// Errors of one class of points or rays.
struct Errors {
  std::vector<double> distance_m;
  std::vector<double> angle_deg;
  int num_gross = 0;

  void Add(double error_m, double angle) {
    distance_m.push_back(error_m);
    angle_deg.push_back(angle);
    if (error_m > kGross_m) ++num_gross;
  }
};

void Print(const std::string& name, const Errors& errors, double of_all) {
  const auto count = static_cast<double>(errors.distance_m.size());
  double squares = 0.0;
  for (const double e : errors.distance_m) squares += e <= kGross_m ? e * e : 0.0;
  std::printf(
      "  %-26s %7.0f (%5.1f %%)  p50 %6.2f  p95 %7.2f  rms %5.2f mm  gross %5.2f %%  normal p50 "
      "%5.2f "
      "p90 %6.2f deg\n",
      name.c_str(), count, of_all > 0.0 ? 100.0 * count / of_all : 0.0,
      1e3 * Quantile(errors.distance_m, 0.5), 1e3 * Quantile(errors.distance_m, 0.95),
      1e3 * std::sqrt(squares / std::max(1.0, count - errors.num_gross)),
      100.0 * errors.num_gross / std::max(1.0, count), Quantile(errors.angle_deg, 0.5),
      Quantile(errors.angle_deg, 0.9));
}

double AngleDeg(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return kDegrees * std::acos(std::min(1.0, std::abs(a.dot(b))));
}

/// The rigid transform that lays the estimated trajectory over the true one: mean rotation between
/// the poses, then mean position.
Rigid3 AlignMaps(const Trajectory& truth, const Trajectory& estimate) {
  Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
  Eigen::Vector3d true_mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  int count = 0;
  for (const TimedPose& pose : estimate.poses()) {
    const auto true_pose = truth.Interpolate(pose.stamp_ns);
    if (!true_pose) continue;
    const Eigen::Vector4d q =
        (true_pose->rotation * pose.map_from_lidar.rotation.conjugate()).coeffs();
    sum += q * q.transpose();
    true_mean += true_pose->translation;
    mean += pose.map_from_lidar.translation;
    ++count;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> solver(sum);
  const Eigen::Quaterniond rotation(Eigen::Vector4d(solver.eigenvectors().col(3)));
  return Rigid3(rotation, true_mean / count - rotation * (mean / count));
}

/// What the simulator has at a surface point: signed distance along the normal, true normal. None
/// when the true surface is farther off than kSearch_m.
struct NearestTruth {
  double distance_m = 0.0;
  double angle_deg = 0.0;
};
std::optional<NearestTruth> TruthAt(const Simulator& simulator, Timestamp stamp_ns,
                                    const Eigen::Vector3d& point_m, const Eigen::Vector3d& normal) {
  std::optional<NearestTruth> best;
  for (const double side : {1.0, -1.0}) {
    const Eigen::Vector3d origin_m = point_m + side * kSearch_m * normal;
    const auto hit = simulator.CastRay(stamp_ns, origin_m, -side * normal);
    if (!hit || hit->range_m > 2.0 * kSearch_m) continue;
    const double distance_m = std::abs(hit->range_m - kSearch_m);
    if (best && best->distance_m <= distance_m) continue;
    best = NearestTruth{distance_m, AngleDeg(hit->normal_in_map, normal)};
  }
  return best;
}

void ReportPoints(const Simulator& simulator, const SceneMap& map, const Rigid3& world_from_map) {
  const Timestamp stamp_ns = map.map_from_lidar.start_ns();
  std::map<std::string, Errors> classes;
  const auto add = [&](const std::string& name, const Eigen::Vector3d& point_m,
                       const Eigen::Vector3d& normal) {
    const auto truth =
        TruthAt(simulator, stamp_ns, world_from_map * point_m, world_from_map.rotation * normal);
    classes[name].Add(truth ? truth->distance_m : kSearch_m, truth ? truth->angle_deg : 90.0);
  };
  double owed = 0.0;  // samples, evenly over the mesh's area
  Random random(1);
  for (const std::array<int, 3>& triangle : map.ground.triangles) {
    const Eigen::Vector3d a = map.ground.vertices_m[triangle[0]].cast<double>();
    const Eigen::Vector3d u = map.ground.vertices_m[triangle[1]].cast<double>() - a;
    const Eigen::Vector3d v = map.ground.vertices_m[triangle[2]].cast<double>() - a;
    const Eigen::Vector3d area = 0.5 * u.cross(v);
    for (owed += kSamplesPerArea * area.norm(); owed >= 1.0; owed -= 1.0) {
      double s = random.Uniform();
      double t = random.Uniform();
      if (s + t > 1.0) {
        s = 1.0 - s;
        t = 1.0 - t;
      }
      add("ground mesh", a + s * u + t * v, area.normalized());
    }
  }
  for (const Surfel& surfel : map.surfels) {
    if (!surfel.planar) continue;
    char name[40];
    std::snprintf(name, sizeof(name), "surfels of %.1f m", surfel.scale_m);
    add(name, surfel.center_m.cast<double>(), surfel.normal.cast<double>().normalized());
    if (surfel.scale_m >= 0.19F) {
      add("surfels >= 0.2 m", surfel.center_m.cast<double>(),
          surfel.normal.cast<double>().normalized());
    }
  }
  for (const auto& [name, errors] : classes) Print(name, errors, 0.0);
}

/// One pixel's ray, its hit and its truth. The truth is laid into the map by the lidar's poses at the
/// ray's time, true and estimated: as the camera sees it, drift over the drive does not count.
struct PixelRay {
  int camera = 0;
  int image = 0;
  Eigen::Vector2d pixel;
  Ray ray;
  Rigid3 map_from_lidar;
  ScenePoint truth;
  Eigen::Vector3d true_point_in_map_m;
  Eigen::Vector3d true_normal_in_map;
  bool at_edge = false;  ///< another object within two pixels
};

/// Rays of a grid of pixels of all cameras. Left out: the sky, what is beyond association's range,
/// the own vehicle and what moves.
std::vector<PixelRay> PixelRays(const SimulatedDrive& drive, const Trajectory& map_from_lidar,
                                const Arguments& arguments) {
  const Simulator& simulator = drive.simulator();
  const AssociationOptions association;
  std::vector<PixelRay> rays;
  for (const ScheduledMeasurement& item : simulator.schedule()) {
    if (item.kind != MeasurementKind::kImage || item.index % arguments.image_step != 0) continue;
    const CameraConfig& config = drive.rig().cameras[item.camera];
    const auto pose = map_from_lidar.Interpolate(item.exposure_ns);
    const auto true_pose = simulator.true_map_from_lidar().Interpolate(item.exposure_ns);
    if (!pose || !true_pose) continue;
    const Rigid3 map_from_world = *pose * true_pose->Inverse();
    const Rigid3 map_from_camera = *pose * config.lidar_from_camera;
    const int first = arguments.pixel_step / 2;
    for (int v = first; v < config.model->height_px(); v += arguments.pixel_step) {
      for (int u = first; u < config.model->width_px(); u += arguments.pixel_step) {
        const Eigen::Vector2d pixel(u, v);
        const auto direction = config.model->Unproject(pixel);
        const auto truth = simulator.TrueScenePoint(item.camera, item.exposure_ns, pixel);
        if (!direction || !truth || truth->is_moving || truth->is_own_vehicle ||
            truth->range_m > association.max_range_m) {
          continue;
        }
        PixelRay ray;
        ray.camera = item.camera;
        ray.image = item.index;
        ray.pixel = pixel;
        ray.ray = {map_from_camera.translation, map_from_camera.rotation * *direction};
        ray.map_from_lidar = *pose;
        ray.truth = *truth;
        ray.true_point_in_map_m = map_from_world * truth->point_in_map_m;
        ray.true_normal_in_map = map_from_world.rotation * truth->normal_in_map;
        for (const Eigen::Vector2d& off : {Eigen::Vector2d(2, 0), Eigen::Vector2d(-2, 0),
                                           Eigen::Vector2d(0, 2), Eigen::Vector2d(0, -2)}) {
          const auto other = simulator.TrueScenePoint(item.camera, item.exposure_ns, pixel + off);
          ray.at_edge |= !other || other->object_id != truth->object_id;
        }
        rays.push_back(ray);
      }
    }
  }
  return rays;
}

/// The motion of the vehicle, a shift and a turn in the lidar's axes, that explains best how far the
/// surfaces lie off: what all cameras would have in common if their tracks were exact. Near surfaces
/// count most, as tracks locate them best.
class CommonShift {
 public:
  void Add(const PixelRay& ray, const RayHit& hit, double error_m) {
    constexpr double kNear_m = 10.0;
    constexpr double kGood_m = 0.005;
    const Rigid3 lidar_from_map = ray.map_from_lidar.Inverse();
    const Eigen::Vector3d normal = lidar_from_map.rotation * hit.normal_in_map;
    Vector6 design;
    design << normal, (lidar_from_map * hit.point_in_map_m).cross(normal);
    const double relative = hit.range_m / kNear_m;
    const double robust = 1.0 + error_m * error_m / (kGood_m * kGood_m);
    const double weight = 1.0 / ((1.0 + relative * relative * relative * relative) * robust);
    information_ += weight * design * design.transpose();
    gradient_ += weight * design * error_m;
  }

  void Print(const std::string& name) const {
    const Vector6 shift = information_.ldlt().solve(gradient_);
    std::printf("  %-26s forward %+.2f  left %+.2f  up %+.2f mm  roll %+.4f  pitch %+.4f  yaw "
                "%+.4f deg\n",
                name.c_str(), 1e3 * shift[0], 1e3 * shift[1], 1e3 * shift[2], kDegrees * shift[3],
                kDegrees * shift[4], kDegrees * shift[5]);
  }

 private:
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  Eigen::Matrix<double, 6, 6> information_ = Eigen::Matrix<double, 6, 6>::Zero();
  Vector6 gradient_ = Vector6::Zero();
};

/// world, camera, image, pixel, ground, index, scale, thickness, points, radius, incidence (rad),
/// range, true range, error, error of the normal (deg), at an edge, true object, planar.
void WriteLine(const std::string& world, const PixelRay& ray, const RayHit& hit,
               const SceneMap& map, double error_m, double angle_deg, std::ofstream* csv) {
  const bool ground = hit.kind == SurfaceKind::kGround;
  *csv << world << ' ' << ray.camera << ' ' << ray.image << ' ' << ray.pixel.transpose() << ' '
       << ground << ' ' << hit.index << ' ' << hit.scale_m << ' ' << hit.thickness_m << ' '
       << (ground ? 0 : map.surfels[hit.index].num_points) << ' '
       << (ground ? 0.0F : map.surfels[hit.index].radius_m) << ' ' << hit.incidence_angle_rad << ' '
       << hit.range_m << ' ' << ray.truth.range_m << ' ' << error_m << ' ' << angle_deg << ' '
       << ray.at_edge << ' ' << ray.truth.object_id << ' ' << hit.planar << '\n';
}

void ReportRays(const std::vector<PixelRay>& rays, const SceneMap& map, std::ofstream* csv,
                const std::string& world) {
  const AssociationOptions association;
  const Result<RayCaster> caster = RayCaster::Create(map);
  if (!caster.ok()) return;
  std::vector<Ray> queries;
  for (const PixelRay& ray : rays) queries.push_back(ray.ray);
  const auto hits = caster->Cast(queries, association.max_range_m);
  std::map<std::string, Errors> classes;
  CommonShift shift;
  std::map<int, CommonShift> shift_of_camera;
  int num_missed = 0;
  int num_grazing = 0;
  int num_not_planar = 0;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const PixelRay& ray = rays[i];
    const auto& hit = hits[i];
    if (!hit) ++num_missed;
    if (!hit) continue;
    const double signed_m =
        hit->normal_in_map.dot(hit->point_in_map_m - ray.true_point_in_map_m);
    const double error_m = std::abs(signed_m);
    const double angle_deg = AngleDeg(hit->normal_in_map, ray.true_normal_in_map);
    if (csv->is_open()) WriteLine(world, ray, *hit, map, error_m, angle_deg, csv);
    if (!hit->planar || hit->thickness_m > association.max_thickness_m) {
      ++num_not_planar;
      continue;
    }
    if (kDegrees * hit->incidence_angle_rad > association.max_incidence_deg) {
      ++num_grazing;
      continue;
    }
    if (error_m < kGross_m) {
      shift.Add(ray, *hit, signed_m);
      shift_of_camera[ray.camera].Add(ray, *hit, signed_m);
    }
    char scale[40];
    std::snprintf(scale, sizeof(scale), "surfels of %.1f m", hit->scale_m);
    const bool ground = hit->kind == SurfaceKind::kGround;
    classes["accepted"].Add(error_m, angle_deg);
    classes[ground ? "ground" : scale].Add(error_m, angle_deg);
    classes[hit->range_m < 20.0 ? "nearer than 20 m" : "beyond 20 m"].Add(error_m, angle_deg);
    if (ray.at_edge) classes["at an object's edge"].Add(error_m, angle_deg);
  }
  const auto num_rays = static_cast<double>(rays.size());
  std::printf(
      "  rays through pixels: %.0f, %.1f %% meet nothing, %.1f %% what is no plane, %.1f %% "
      "graze\n",
      num_rays, 100.0 * num_missed / num_rays, 100.0 * num_not_planar / num_rays,
      100.0 * num_grazing / num_rays);
  for (const auto& [name, errors] : classes) Print(name, errors, num_rays);
  shift.Print("vehicle shifted by");
  for (const auto& [camera, its] : shift_of_camera) {
    its.Print("  seen by camera " + std::to_string(camera));
  }
}

Result<SceneMap> MapDrive(const SimulatedDrive& drive, bool true_trajectory) {
  SegmentMapper mapper(drive.rig(), MappingOptions());
  for (const ImuSample& sample : drive.imu()) mapper.AddImu(sample);
  for (const OdometrySample& sample : drive.odometry()) mapper.AddOdometry(sample);
  for (int i = 0; i < drive.num_scans(); ++i) {
    const auto registration = mapper.AddScan(drive.Scan(i));
    if (!registration.ok()) std::printf("  %s\n", registration.status().message().c_str());
  }
  Result<MappingResult> result =
      true_trajectory
          ? mapper.BuildMapWithTrajectory(drive.simulator().true_map_from_lidar(), {})
          : mapper.BuildMap({});
  if (!result.ok()) return result.status();
  return std::move(result->map);
}

Status Run(const Arguments& arguments, std::ofstream* csv) {
  const Result<SimulatedDrive> drive = SimulatedDrive::Create(arguments.drive);
  if (!drive.ok()) return drive.status();
  std::printf("%s, %s trajectory\n", Describe(arguments.drive).c_str(),
              arguments.true_trajectory ? "true" : "estimated");
  const Result<SceneMap> map = MapDrive(*drive, arguments.true_trajectory);
  if (!map.ok()) return map.status();
  const Rigid3 world_from_map =
      AlignMaps(drive->simulator().true_map_from_lidar(), map->map_from_lidar);
  ReportPoints(drive->simulator(), *map, world_from_map);
  ReportRays(PixelRays(*drive, map->map_from_lidar, arguments), *map, csv, arguments.drive.world);
  std::fflush(stdout);
  return Status::Ok();
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("Accuracy of ground and surfels on simulated drives.");
  scenecalib::Arguments arguments;
  app.add_option("--world", arguments.worlds, scenecalib::KnownWorldKinds());
  app.add_option("--seed", arguments.seeds, "of the worlds and drives");
  app.add_option("--rig", arguments.drive.rig, "rig file (default: the built-in rig)");
  app.add_option("--drive", arguments.drive.drive, "turns, gentle or straight");
  app.add_option("--duration", arguments.drive.duration_s, "seconds");
  app.add_option("--speed", arguments.drive.speed_m_s, "mean, m/s");
  scenecalib::AddLidarArguments(&app, &arguments.drive.lidar);
  app.add_option("--cache", arguments.drive.cache_directory, "directory to keep the scans in");
  app.add_flag("--true-trajectory", arguments.true_trajectory, "instead of the estimated one");
  app.add_option("--pixel-step", arguments.pixel_step, "every so many pixels have their ray cast");
  app.add_option("--image-step", arguments.image_step, "of every so many images");
  app.add_option("--rays", arguments.rays_csv, "file for a line per accepted ray");
  CLI11_PARSE(app, argc, argv);
  std::ofstream csv;
  if (!arguments.rays_csv.empty()) csv.open(arguments.rays_csv);
  for (const std::string& world : arguments.worlds) {
    for (const int seed : arguments.seeds) {
      arguments.drive.world = world;
      arguments.drive.seed = seed;
      const scenecalib::Status status = scenecalib::Run(arguments, &csv);
      if (!status.ok()) {
        std::fprintf(stderr, "%s\n", status.message().c_str());
        return 1;
      }
    }
  }
  return 0;
}
