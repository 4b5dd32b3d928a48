#pragma once

#include <Eigen/Core>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/sensor/camera_factory.h"
#include "scenecalib/sensor/rig.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {
namespace testing {

/// A street canyon made of exact planes, a drive through it and exact (or noisy) tracks: truth for
/// tests of association and calibration, without images and without lidar.
struct CanyonScene {
  Rig rig;  ///< the truth
  SceneMap map;
  std::vector<CameraSegment> segments;
};

struct CanyonOptions {
  double duration_s = 6.0;
  double speed_m_s = 6.0;
  double turn_amplitude_rad = 0.25;
  double pixel_noise_px = 0.05;
  int tracks_per_camera = 500;
  /// Smooth error added to the trajectory in the map (the tracks are seen from the true one).
  double trajectory_error_m = 0.0;
  std::uint64_t seed = 1;
};

/// map_from_lidar(t) of the drive: forward along x with curves, pitch and roll.
inline Rigid3 CanyonPose(const CanyonOptions& options, double t) {
  const double yaw = options.turn_amplitude_rad * std::sin(1.1 * t);
  const double pitch = 0.012 * std::sin(6.0 * t);
  const double roll = 0.010 * std::sin(4.5 * t + 1.0);
  return {ExpSo3({0.0, 0.0, yaw}) * ExpSo3({0.0, pitch, 0.0}) * ExpSo3({roll, 0.0, 0.0}),
          {options.speed_m_s * t, 1.2 * std::sin(0.7 * t), 0.03 * std::sin(5.0 * t)}};
}

inline CameraConfig CanyonCamera(const std::string& name, double yaw_rad, double focal_px,
                                 bool fisheye) {
  CameraIntrinsics intrinsics;
  intrinsics.width_px = fisheye ? 1280 : 960;
  intrinsics.height_px = fisheye ? 720 : 600;
  intrinsics.principal_point_px = {0.5 * intrinsics.width_px + 3.0,
                                   0.5 * intrinsics.height_px - 2.0};
  if (fisheye) {
    intrinsics.model = "ftheta";
    intrinsics.polynomial_px = {focal_px, 1.0, -6.0, 0.8, 0.0};
  } else {
    intrinsics.model = "plumb_bob";
    intrinsics.focal_px = {focal_px, focal_px};
    intrinsics.distortion = {-0.05, 0.01, 0.0, 0.0, 0.0};
  }
  Eigen::Matrix3d forward;
  forward << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  CameraConfig camera;
  camera.name = name;
  camera.image_topic = "/" + name + "/image_raw";
  camera.frame_id = name + "_optical";
  camera.model = CreateCameraModel(intrinsics).value();
  camera.lidar_from_camera = Rigid3(
      ExpSo3({0.0, 0.0, yaw_rad}) * Eigen::Quaterniond(forward) * ExpSo3({-0.05, 0.01, 0.01}),
      {0.8, 0.3 * std::sin(yaw_rad), -0.4});
  return camera;
}

inline Surfel Disc(const Eigen::Vector3f& center, const Eigen::Vector3f& normal, float radius) {
  Surfel surfel;
  surfel.center_m = center;
  surfel.normal = normal.normalized();
  surfel.radius_m = radius;
  surfel.thickness_m = 0.005F;
  surfel.scale_m = 1.6F;
  surfel.num_points = 100;
  return surfel;
}

/// Ground z = -2 as a mesh; walls y = +-9, with piers every 6 m whose faces look along the street.
inline void AddCanyonSurfaces(double length_m, SceneMap* map) {
  const auto x_end = static_cast<float>(length_m + 80.0);
  constexpr float kCell_m = 0.2F;  // as fine as a mapped mesh
  constexpr int kAcross = 91;
  for (float x = -30.0F; x < x_end; x += kCell_m) {
    for (int j = 0; j < kAcross; ++j) {
      const int here = static_cast<int>(map->ground.vertices_m.size());
      map->ground.vertices_m.emplace_back(x, -9.0F + kCell_m * static_cast<float>(j), -2.0F);
      if (j + 1 == kAcross || x + kCell_m >= x_end) continue;
      map->ground.triangles.push_back({here, here + kAcross, here + 1});
      map->ground.triangles.push_back({here + 1, here + kAcross, here + kAcross + 1});
    }
  }
  for (float x = -30.0F; x < x_end; x += 1.0F) {
    for (float z = -1.5F; z < 9.0F; z += 1.0F) {
      for (const float side : {-1.0F, 1.0F}) {
        map->surfels.push_back(Disc({x, 9.0F * side, z}, {0, -side, 0}, 0.71F));
        if (std::fmod(x + 60.0F, 6.0F) < 0.5F) {
          map->surfels.push_back(Disc({x + 0.4F, 8.4F * side, z}, {-1, 0, 0}, 0.71F));
        }
      }
    }
  }
}

/// Where a ray from the street first meets the canyon; none beyond 60 m.
inline bool MeetCanyon(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                       Eigen::Vector3d* point) {
  double best = 60.0;
  if (direction.z() < -1e-6) best = std::min(best, (-2.0 - origin.z()) / direction.z());
  if (std::abs(direction.y()) > 1e-6) {
    best = std::min(best, (std::copysign(9.0, direction.y()) - origin.y()) / direction.y());
  }
  for (int k = -5; k < 40; ++k) {
    const double face_x = 6.0 * k + 0.4;
    const double range = (face_x - origin.x()) / direction.x();
    if (!(range > 0.0) || range >= best) continue;
    const Eigen::Vector3d at = origin + range * direction;
    if (std::abs(at.y()) > 7.9 && std::abs(at.y()) < 8.9 && at.z() > -1.9 && at.z() < 8.5) {
      best = range;
    }
  }
  if (best >= 60.0) return false;
  *point = origin + best * direction;
  return point->z() < 8.0;
}

/// One track: a random pixel of a random image and the other images that see the same point; fewer
/// than four views when the pixel shows the sky.
inline Track MakeCanyonTrack(const CameraConfig& camera, const CanyonOptions& options,
                             double phase_s, Timestamp start_ns, Random* random) {
  const CameraModel& model = *camera.model;
  const int num_images = static_cast<int>((options.duration_s - 0.1) / 0.1);
  const int middle = static_cast<int>(random->Index(num_images));
  const double line_time_s = camera.rolling_shutter_line_time_s.value_or(0.0);
  const auto map_from_camera_at = [&](int image, double row_px) {
    return CanyonPose(options, 0.1 * image + phase_s + line_time_s * row_px) *
           camera.lidar_from_camera;
  };
  const Eigen::Vector2d pixel(random->Uniform(5.0, model.width_px() - 6.0),
                              random->Uniform(5.0, model.height_px() - 6.0));
  Track track;
  const auto ray = model.Unproject(pixel);
  const Rigid3 map_from_camera = map_from_camera_at(middle, pixel.y());
  Eigen::Vector3d point;
  if (!ray || ray->z() < -0.3 ||
      !MeetCanyon(map_from_camera.translation, map_from_camera.rotation * *ray, &point)) {
    return track;
  }
  for (int image = std::max(0, middle - 8); image < std::min(num_images, middle + 9); ++image) {
    Rigid3 pose = map_from_camera_at(image, pixel.y());
    auto seen = model.Project(pose.Inverse() * point);
    for (int step = 0; step < 6 && seen && line_time_s != 0.0; ++step) {
      pose = map_from_camera_at(image, seen->y());
      seen = model.Project(pose.Inverse() * point);
    }
    Eigen::Vector3d met;
    if (!seen || !MeetCanyon(pose.translation, (point - pose.translation).normalized(), &met) ||
        (met - point).norm() > 0.01) {
      continue;
    }
    if (image == middle) track.reference = static_cast<int>(track.observations.size());
    // The reference view defines the point: its pixel is exact.
    const double noise_px = image == middle ? 0.0 : options.pixel_noise_px;
    TrackObservation observation;
    observation.stamp_ns = AddSeconds(start_ns, 0.1 * image + phase_s);
    observation.pixel = *seen + noise_px * Eigen::Vector2d(random->Gaussian(), random->Gaussian());
    observation.covariance_px2 =
        options.pixel_noise_px * options.pixel_noise_px * Eigen::Matrix2d::Identity();
    track.observations.push_back(observation);
  }
  return track;
}

inline CanyonScene MakeCanyonScene(const std::vector<CameraConfig>& cameras,
                                   const CanyonOptions& options) {
  constexpr Timestamp kStart = 1700000000000000000;
  CanyonScene scene;
  scene.rig.lidar.topic = "/lidar/points";
  scene.rig.lidar.frame_id = "lidar";
  scene.rig.cameras = cameras;
  AddCanyonSurfaces(options.duration_s * options.speed_m_s, &scene.map);
  std::vector<TimedPose> poses;
  for (double t = 0.0; t <= options.duration_s; t += 0.01) {
    Rigid3 pose = CanyonPose(options, t);
    pose.translation += options.trajectory_error_m *
                        Eigen::Vector3d(std::sin(1.7 * t), std::cos(1.3 * t), std::sin(2.1 * t));
    poses.push_back({AddSeconds(kStart, t), pose});
  }
  scene.map.map_from_lidar = Trajectory::Create(std::move(poses)).value();
  Random random(options.seed);
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    CameraSegment segment;
    const double phase_s = 0.013 * static_cast<double>(c + 1);  // no two cameras fire together
    for (int id = 0; id < options.tracks_per_camera; ++id) {
      Track track = MakeCanyonTrack(cameras[c], options, phase_s, kStart, &random);
      track.id = id;
      if (track.observations.size() >= 4) segment.tracks.push_back(std::move(track));
    }
    scene.segments.push_back(std::move(segment));
  }
  return scene;
}

/// The rig with every camera turned and moved by the given amounts about random axes.
inline Rig Perturb(const Rig& rig, double rotation_rad, double translation_m, std::uint64_t seed) {
  Rig perturbed = rig;
  Random random(seed);
  for (CameraConfig& camera : perturbed.cameras) {
    const auto direction = [&random]() {
      return Eigen::Vector3d(
          Eigen::Vector3d(random.Gaussian(), random.Gaussian(), random.Gaussian()).normalized());
    };
    const Eigen::Vector3d turn = rotation_rad * direction();
    const Eigen::Vector3d shift = translation_m * direction();
    camera.lidar_from_camera = camera.lidar_from_camera * Rigid3(ExpSo3(turn), shift);
  }
  return perturbed;
}

}  // namespace testing
}  // namespace scenecalib
