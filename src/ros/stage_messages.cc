#include "scenecalib/ros/stage_messages.h"

#include <algorithm>
#include <opencv2/imgcodecs.hpp>
#include <utility>
#include <vector>

#include "scenecalib/io/rig_yaml.h"
#include "scenecalib/ros/message_conversion.h"

namespace scenecalib {
namespace {

SurfelDisc ToMessage(const Surfel& surfel) {
  SurfelDisc message;
  for (int i = 0; i < 3; ++i) {
    message.center[static_cast<std::size_t>(i)] = surfel.center_m[i];
    message.normal[static_cast<std::size_t>(i)] = surfel.normal[i];
  }
  message.radius = surfel.radius_m;
  message.thickness = surfel.thickness_m;
  message.scale = surfel.scale_m;
  message.num_points = surfel.num_points;
  message.first_seen = ToRosTime(surfel.first_seen_ns);
  message.last_seen = ToRosTime(surfel.last_seen_ns);
  message.planar = surfel.planar;
  return message;
}

Surfel FromMessage(const SurfelDisc& message) {
  Surfel surfel;
  surfel.center_m = {message.center[0], message.center[1], message.center[2]};
  surfel.normal = {message.normal[0], message.normal[1], message.normal[2]};
  surfel.radius_m = message.radius;
  surfel.thickness_m = message.thickness;
  surfel.scale_m = message.scale;
  surfel.num_points = message.num_points;
  surfel.first_seen_ns = FromRosTime(message.first_seen);
  surfel.last_seen_ns = FromRosTime(message.last_seen);
  surfel.planar = message.planar != 0;
  return surfel;
}

PixelTrack ToMessage(const Track& track) {
  PixelTrack message;
  message.id = track.id;
  message.reference = track.reference;
  message.patch_radius = track.patch_radius_px;
  for (const TrackObservation& observation : track.observations) {
    message.stamps.push_back(ToRosTime(observation.stamp_ns));
    message.pixels.insert(message.pixels.end(), {observation.pixel.x(), observation.pixel.y()});
    const Eigen::Matrix2d& covariance = observation.covariance_px2;
    message.covariances.insert(message.covariances.end(),
                               {covariance(0, 0), covariance(0, 1), covariance(1, 1)});
  }
  return message;
}

Result<Track> FromMessage(const PixelTrack& message) {
  const std::size_t count = message.stamps.size();
  if (message.pixels.size() != 2 * count || message.covariances.size() != 3 * count ||
      message.reference < 0 || static_cast<std::size_t>(message.reference) >= count) {
    return Status::InvalidArgument("track " + std::to_string(message.id) +
                                   ": arrays of different length");
  }
  Track track;
  track.id = message.id;
  track.reference = message.reference;
  track.patch_radius_px = message.patch_radius;
  for (std::size_t i = 0; i < count; ++i) {
    TrackObservation observation;
    observation.stamp_ns = FromRosTime(message.stamps[i]);
    observation.pixel = {message.pixels[2 * i], message.pixels[2 * i + 1]};
    const double* covariance = &message.covariances[3 * i];
    observation.covariance_px2 << covariance[0], covariance[1], covariance[1], covariance[2];
    track.observations.push_back(observation);
  }
  return track;
}

/// Vertices and triangles; every index must name a vertex.
Result<TriangleMesh> GroundFromMessage(const MapSnapshot& message) {
  TriangleMesh ground;
  const std::vector<float>& xyz = message.ground_vertices;
  const std::vector<std::int32_t>& indices = message.ground_triangles;
  if (xyz.size() % 3 != 0 || indices.size() % 3 != 0) {
    return Status::InvalidArgument("map: ground mesh is cut off");
  }
  for (std::size_t i = 0; i < xyz.size(); i += 3) {
    ground.vertices_m.emplace_back(xyz[i], xyz[i + 1], xyz[i + 2]);
  }
  const auto num_vertices = static_cast<std::int32_t>(ground.vertices_m.size());
  for (std::size_t i = 0; i < indices.size(); i += 3) {
    const std::array<int, 3> triangle = {indices[i], indices[i + 1], indices[i + 2]};
    for (const int vertex : triangle) {
      if (vertex < 0 || vertex >= num_vertices) {
        return Status::InvalidArgument("map: a ground triangle names no vertex");
      }
    }
    ground.triangles.push_back(triangle);
  }
  return ground;
}

Result<Trajectory> TrajectoryFromMessage(const MapSnapshot& message) {
  if (message.trajectory_stamps.size() != message.trajectory.size()) {
    return Status::InvalidArgument("map: trajectory with stamps and poses of different number");
  }
  std::vector<TimedPose> poses;
  for (std::size_t i = 0; i < message.trajectory.size(); ++i) {
    const Result<Rigid3> pose = FromPoseMessage(message.trajectory[i]);
    if (!pose.ok()) return pose.status();
    poses.push_back({FromRosTime(message.trajectory_stamps[i]), *pose});
  }
  return Trajectory::Create(std::move(poses));
}

}  // namespace

MapSnapshot ToMessage(const SceneMap& map, const std::string& map_frame_id) {
  MapSnapshot message;
  message.header.frame_id = map_frame_id;
  for (const TimedPose& pose : map.map_from_lidar.poses()) {
    message.trajectory_stamps.push_back(ToRosTime(pose.stamp_ns));
    message.trajectory.push_back(ToPoseMessage(pose.map_from_lidar));
  }
  if (!map.map_from_lidar.empty()) {
    message.header.stamp = ToRosTime(map.map_from_lidar.end_ns());
  }
  for (const Eigen::Vector3f& v : map.ground.vertices_m) {
    message.ground_vertices.insert(message.ground_vertices.end(), {v.x(), v.y(), v.z()});
  }
  for (const std::array<int, 3>& t : map.ground.triangles) {
    message.ground_triangles.insert(message.ground_triangles.end(), t.begin(), t.end());
  }
  for (const Surfel& surfel : map.surfels) message.surfels.push_back(ToMessage(surfel));
  for (const MapPoint& p : map.points) {
    message.points.insert(message.points.end(),
                          {p.position_m.x(), p.position_m.y(), p.position_m.z(), p.intensity});
  }
  for (const RelativeMotionSigma& sigma : map.relative_motion) {
    message.relative_motion.insert(message.relative_motion.end(),
                                   {sigma.window_s, sigma.translation_m, sigma.rotation_rad});
  }
  message.lidar_frame_translation_m = map.lidar_frame.translation_m;
  message.lidar_frame_rotation_rad = map.lidar_frame.rotation_rad;
  return message;
}

Result<SceneMap> FromMessage(const MapSnapshot& message) {
  Result<Trajectory> trajectory = TrajectoryFromMessage(message);
  if (!trajectory.ok()) return trajectory.status();
  Result<TriangleMesh> ground = GroundFromMessage(message);
  if (!ground.ok()) return ground.status();
  if (message.points.size() % 4 != 0 || message.relative_motion.size() % 3 != 0) {
    return Status::InvalidArgument("map: points or relative motion are cut off");
  }
  SceneMap map;
  map.map_from_lidar = std::move(trajectory).value();
  map.ground = std::move(ground).value();
  for (const SurfelDisc& surfel : message.surfels) map.surfels.push_back(FromMessage(surfel));
  for (std::size_t i = 0; i < message.points.size(); i += 4) {
    const float* p = &message.points[i];
    map.points.push_back({Eigen::Vector3f(p[0], p[1], p[2]), p[3]});
  }
  for (std::size_t i = 0; i < message.relative_motion.size(); i += 3) {
    const double* sigma = &message.relative_motion[i];
    map.relative_motion.push_back({sigma[0], sigma[1], sigma[2]});
  }
  map.lidar_frame = {message.lidar_frame_translation_m, message.lidar_frame_rotation_rad};
  return map;
}

namespace {

sensor_msgs::CompressedImage ToPng(Timestamp stamp_ns, const cv::Mat& pixels) {
  sensor_msgs::CompressedImage image;
  image.header.stamp = ToRosTime(stamp_ns);
  image.format = "png";
  cv::imencode(".png", pixels, image.data);
  return image;
}

/// Decodes every image; false when one cannot be.
bool FromPng(const std::vector<sensor_msgs::CompressedImage>& messages, int flags,
             std::map<Timestamp, cv::Mat>* images) {
  for (const sensor_msgs::CompressedImage& message : messages) {
    const cv::Mat pixels = message.data.empty() ? cv::Mat() : cv::imdecode(message.data, flags);
    if (pixels.empty()) return false;
    (*images)[FromRosTime(message.header.stamp)] = pixels;
  }
  return true;
}

}  // namespace

void FillSegment(const CameraSegment& segment, GetSegmentResponse* response) {
  for (const Track& track : segment.tracks) response->tracks.push_back(ToMessage(track));
  for (const auto& [stamp_ns, pixels] : segment.images) {
    response->images.push_back(ToPng(stamp_ns, pixels));
  }
  for (const auto& [stamp_ns, pixels] : segment.colour_images) {
    response->colour_images.push_back(ToPng(stamp_ns, pixels));
  }
  response->num_images_in = segment.num_images_in;
  response->num_images_dropped_at_bound = segment.num_images_dropped_at_bound;
  response->mean_brightness = segment.mean_brightness;
  response->warnings = segment.warnings;
}

Result<CameraSegment> FromMessage(const GetSegmentResponse& response) {
  CameraSegment segment;
  for (const PixelTrack& message : response.tracks) {
    Result<Track> track = FromMessage(message);
    if (!track.ok()) return track.status();
    segment.tracks.push_back(std::move(track).value());
  }
  if (!FromPng(response.images, cv::IMREAD_GRAYSCALE, &segment.images) ||
      !FromPng(response.colour_images, cv::IMREAD_COLOR, &segment.colour_images)) {
    return Status::InvalidArgument("segment: an image cannot be decoded");
  }
  segment.num_images_in = response.num_images_in;
  segment.num_images_dropped_at_bound = response.num_images_dropped_at_bound;
  segment.mean_brightness = response.mean_brightness;
  segment.warnings = response.warnings;
  return segment;
}

Calibration ToMessage(const CalibrationResult& result, Timestamp stamp_ns) {
  Calibration message;
  message.header.stamp = ToRosTime(stamp_ns);
  message.header.frame_id = result.rig.lidar.frame_id;
  message.accepted = result.accepted;
  message.reasons = result.reasons;
  for (std::size_t i = 0; i < result.rig.cameras.size(); ++i) {
    const CameraConfig& camera = result.rig.cameras[i];
    const CameraQuality& quality = result.cameras[i];
    CameraResult item;
    item.name = camera.name;
    item.frame_id = camera.frame_id;
    item.accepted = quality.accepted;
    item.reasons = quality.reasons;
    item.lidar_from_camera = ToTransformMessage(camera.lidar_from_camera);
    item.time_offset_s = camera.time_offset_s;
    for (int axis = 0; axis < 3; ++axis) {
      const auto at = static_cast<std::size_t>(axis);
      item.translation_stddev_m[at] = quality.stddev.translation_m[axis];
      item.rotation_stddev_rad[at] = quality.stddev.rotation_rad[axis];
    }
    item.num_tracks = quality.num_tracks;
    item.num_inlier_tracks = quality.num_inlier_tracks;
    item.rms_before_px = quality.rms_before_px;
    item.rms_after_px = quality.rms_after_px;
    message.cameras.push_back(std::move(item));
  }
  message.yaml = FormatCalibration(result);
  return message;
}

}  // namespace scenecalib
