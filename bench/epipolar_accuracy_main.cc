// Feature tracks of a recording against the epipolar lines of a given rig (say a dataset's own
// calibration) and the lidar trajectory that the mapping refines: the one check of tracks that real
// images allow, blind to errors along the lines.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "bench/quantile.h"
#include "scenecalib/ros/prepared_recording.h"
#include "scenecalib/sensor/image_pose.h"

namespace scenecalib {
namespace {

/// Below it the line's direction is the trajectory's noise.
constexpr double kMinBaseline_m = 0.2;
constexpr double kGross_px = 2.0;

/// Distance in pixels of a sighting from the epipolar line of the track's reference; none where a
/// ray or a pose is missing, the camera stood still, or the line is a point.
std::optional<double> DistancePx(const CameraModel& camera, const ImagePose& from,
                                 const Eigen::Vector2d& from_pixel, const ImagePose& to,
                                 const Eigen::Vector2d& to_pixel) {
  UnprojectionJacobians jacobians;
  const auto from_ray = camera.Unproject(from_pixel);
  const auto to_ray = camera.Unproject(to_pixel, &jacobians);
  if (!from_ray || !to_ray) return std::nullopt;
  const Rigid3 to_from_from = to.At(to_pixel.y()).Inverse() * from.At(from_pixel.y());
  const Eigen::Vector3d& baseline_m = to_from_from.translation;
  if (baseline_m.norm() < kMinBaseline_m) return std::nullopt;
  const Eigen::Vector3d normal = baseline_m.cross(to_from_from.rotation * *from_ray);
  const double scale = (jacobians.ray_by_pixel.transpose() * normal).norm();
  if (scale < 1e-12) return std::nullopt;
  return std::abs(to_ray->dot(normal)) / scale;
}

void Judge(const CameraConfig& camera, const Trajectory& map_from_lidar,
           const CameraSegment& segment) {
  std::vector<double> distances_px;
  std::map<Timestamp, int> live;
  std::size_t num_sightings = 0;
  int num_judged = 0;
  int num_gross = 0;
  for (const Track& track : segment.tracks) {
    num_sightings += track.observations.size();
    for (const TrackObservation& o : track.observations) ++live[o.stamp_ns];
    const TrackObservation& reference =
        track.observations[static_cast<std::size_t>(track.reference)];
    const auto from = ImagePoseOf(camera, map_from_lidar, reference.stamp_ns);
    if (!from) continue;
    double largest_px = -1.0;
    for (const TrackObservation& o : track.observations) {
      if (o.stamp_ns == reference.stamp_ns) continue;
      const auto to = ImagePoseOf(camera, map_from_lidar, o.stamp_ns);
      if (!to) continue;
      const auto distance_px = DistancePx(*camera.model, *from, reference.pixel, *to, o.pixel);
      if (!distance_px) continue;
      distances_px.push_back(*distance_px);
      largest_px = std::max(largest_px, *distance_px);
    }
    num_judged += largest_px >= 0.0 ? 1 : 0;
    num_gross += largest_px > kGross_px ? 1 : 0;
  }
  std::printf(
      "%s: %zu tracks, mean length %.1f, live in an image %.0f of %d x %d px\n"
      "  distance from the epipolar line, %zu sightings: median %.3f, 95 %% %.3f px; %.2f %% of "
      "tracks off by over %.0f px\n",
      camera.name.c_str(), segment.tracks.size(),
      static_cast<double>(num_sightings) /
          static_cast<double>(std::max<std::size_t>(1, segment.tracks.size())),
      static_cast<double>(num_sightings) /
          static_cast<double>(std::max<std::size_t>(1, live.size())),
      camera.model->width_px(), camera.model->height_px(), distances_px.size(),
      Quantile(distances_px, 0.5), Quantile(distances_px, 0.95),
      100.0 * num_gross / std::max(1, num_judged), kGross_px);
}

Result<int> Run(const RecordingArguments& arguments) {
  const Result<PreparedRecording> recording = PrepareRecording(arguments, {});
  if (!recording.ok()) return recording.status();
  const PipelineResult& prepared = recording->prepared;
  const Rig& rig = recording->rigs.front();
  for (std::size_t c = 0; c < rig.cameras.size(); ++c) {
    Judge(rig.cameras[c], prepared.mapping.map.map_from_lidar, prepared.segments[c]);
  }
  return 0;
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("Feature tracks of a recording against the epipolar lines of a rig.");
  scenecalib::RecordingArguments arguments;
  scenecalib::DeclareRecordingArguments(&app, &arguments);
  return scenecalib::RunTool("epipolar_accuracy", argc, argv, &app,
                             [&] { return scenecalib::Run(arguments); });
}
