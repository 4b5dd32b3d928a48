// Accuracy of the feature tracks against the simulator's exact flow: the true scene point of a
// track's first view, carried along by what it belongs to, projected into the other views.
// Four cameras of 30, 70, 120 and 200 degrees on one drive; one block of figures per camera.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <vector>

#include "bench/quantile.h"
#include "scenecalib/base/random.h"
#include "scenecalib/io/options_yaml.h"
#include "scenecalib/io/rig_yaml.h"
#include "scenecalib/sensor/camera_factory.h"
#include "scenecalib/simulation/simulator.h"
#include "scenecalib/simulation/world.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {
namespace {

struct Arguments {
  SimulationOptions simulation;
  std::vector<std::string> cameras = {"narrow", "front", "left", "fisheye"};
  std::string rig;
  std::string cache_directory;
  std::string config;
  std::string tracks;
  double night_stops = 0.0;
  double night_noise_levels = 3.0;
};

/// The default rig and a camera of 30 degrees beside the front one.
Result<Rig> RigWithNarrowCamera() {
  Result<Rig> rig = DefaultRig();
  if (!rig.ok()) return rig.status();
  CameraConfig narrow = rig->cameras.front();
  narrow.name = "narrow";
  narrow.image_topic = "/narrow/image_raw/compressed";
  narrow.frame_id = "narrow_optical";
  CameraIntrinsics intrinsics = narrow.model->intrinsics();
  intrinsics.focal_px = {1791.0, 1792.0};
  intrinsics.distortion = {-0.02, 0.01, 0.0002, -0.0002, 0.0};
  const auto model = CreateCameraModel(intrinsics);
  if (!model.ok()) return model.status();
  narrow.model = *model;
  rig->cameras.insert(rig->cameras.begin(), narrow);
  return rig;
}

/// One camera's images with their true exposure times.
struct Footage {
  std::vector<GrayImage> images;
  std::map<Timestamp, Timestamp> exposure_ns;  ///< by stamp
};

/// Exposure down by some stops, under a response of gamma 2.2; sensor noise on top.
cv::Mat AtNight(const cv::Mat& day, double stops, double noise_levels, int seed) {
  const double scale = std::pow(2.0, -stops / 2.2);
  Random random(static_cast<std::uint64_t>(seed) + 77);
  cv::Mat night(day.size(), CV_8UC1);
  for (int y = 0; y < day.rows; ++y) {
    for (int x = 0; x < day.cols; ++x) {
      const double level = scale * day.at<uchar>(y, x) + noise_levels * random.Gaussian();
      night.at<uchar>(y, x) = cv::saturate_cast<uchar>(level);
    }
  }
  return night;
}

/// Images once rendered are kept as PNG files and read again by a later run.
Footage Film(const Simulator& simulator, int camera, const Arguments& arguments) {
  namespace fs = std::filesystem;
  const SimulationOptions& options = arguments.simulation;
  const std::string name = simulator.true_rig().cameras[static_cast<std::size_t>(camera)].name;
  char folder[256];
  std::snprintf(folder, sizeof(folder), "%s_%s_seed_%d_%.1f_s_%.1f_m_s_%.0f_hz_%d_cars_%s",
                options.world.kind.c_str(), options.drive.kind.c_str(), options.seed,
                options.duration_s, options.drive.speed_m_s, options.camera.rate_hz,
                options.world.num_moving_cars, name.c_str());
  const fs::path directory = fs::path(arguments.cache_directory) / folder;
  if (!arguments.cache_directory.empty()) fs::create_directories(directory);
  Footage footage;
  for (const ScheduledMeasurement& measurement : simulator.schedule()) {
    if (measurement.kind != MeasurementKind::kImage || measurement.camera != camera) continue;
    const std::string file = (directory / (std::to_string(measurement.index) + ".png")).string();
    cv::Mat pixels;
    if (!arguments.cache_directory.empty()) pixels = cv::imread(file, cv::IMREAD_GRAYSCALE);
    if (pixels.empty()) {
      pixels = simulator.RenderImage(camera, measurement.index);
      if (!arguments.cache_directory.empty()) {
        cv::imwrite(file, pixels, {cv::IMWRITE_PNG_COMPRESSION, 1});
      }
    }
    if (arguments.night_stops > 0.0) {
      pixels =
          AtNight(pixels, arguments.night_stops, arguments.night_noise_levels, measurement.index);
    }
    footage.images.push_back({measurement.stamp_ns, pixels});
    footage.exposure_ns[measurement.stamp_ns] = measurement.exposure_ns;
  }
  return footage;
}

/// What the truth says of one camera's tracks.
struct Judgement {
  std::vector<double> error_px;             ///< of every observation but the first of its track
  std::map<int, std::vector<double>> aged;  ///< error by observations since the first
  /// The same of tracks whose first pixel shows one surface only. Beside an edge the tracker
  /// follows the edge, while the point that is taken for the truth may lie on what is behind.
  std::map<int, std::vector<double>> aged_off_edges;
  /// The part across the epipolar line: a patch that holds two depths is followed at one between
  /// them, which shows along the line only; what drifts shows in both.
  std::map<int, std::vector<double>> aged_across;
  std::vector<double> normalised;  ///< squared error by stated covariance, per degree of freedom
  int num_tracks = 0;
  int num_judged = 0;
  int num_gross = 0;   ///< with an observation off by over 2 px
  int num_moving = 0;  ///< on moving cars
  int num_own_vehicle = 0;
  int num_at_edge = 0;
  std::map<Timestamp, int> live;
  double length_sum = 0.0;
};

/// Whether a pixel within 0.7 px of this one shows something that lies over 3 cm off its plane.
bool IsAtEdge(const Simulator& simulator, int camera, Timestamp exposure_ns,
              const Eigen::Vector2d& pixel, const ScenePoint& point) {
  constexpr double kNear_px = 0.7;
  constexpr double kOffPlane_m = 0.03;
  constexpr int kNumDirections = 8;
  for (int i = 0; i < kNumDirections; ++i) {
    const double angle_rad = 2.0 * M_PI * i / kNumDirections;
    const auto near = simulator.TrueScenePoint(
        camera, exposure_ns,
        pixel + kNear_px * Eigen::Vector2d(std::cos(angle_rad), std::sin(angle_rad)));
    if (!near || std::abs(point.normal_in_map.dot(near->point_in_map_m - point.point_in_map_m)) >
                     kOffPlane_m) {
      return true;
    }
  }
  return false;
}

/// Direction, in the later image, in which a point moves if it lies farther away along the first
/// view's ray; none where it hardly moves.
std::optional<Eigen::Vector2d> EpipolarDirection(const Simulator& simulator, int camera,
                                                 Timestamp from_ns, Timestamp to_ns,
                                                 const Eigen::Vector3d& point_in_map_m) {
  constexpr double kFarther = 1.02;
  constexpr double kMinMotion_px = 0.1;
  const auto map_from_lidar = simulator.MapFromLidar(from_ns);
  if (!map_from_lidar) return std::nullopt;
  const CameraConfig& config = simulator.true_rig().cameras[static_cast<std::size_t>(camera)];
  const Eigen::Vector3d eye_m = (*map_from_lidar * config.lidar_from_camera).translation;
  const auto near = simulator.TruePixel(camera, to_ns, point_in_map_m);
  const auto far = simulator.TruePixel(camera, to_ns, eye_m + kFarther * (point_in_map_m - eye_m));
  if (!near || !far || (*far - *near).norm() < kMinMotion_px) return std::nullopt;
  return (*far - *near).normalized();
}

Judgement Judge(const Simulator& simulator, int camera, const Footage& footage,
                const std::vector<Track>& tracks) {
  Judgement judgement;
  for (const Track& track : tracks) {
    ++judgement.num_tracks;
    judgement.length_sum += static_cast<double>(track.observations.size());
    for (const TrackObservation& o : track.observations) ++judgement.live[o.stamp_ns];
    const TrackObservation& first = track.observations.front();
    const Timestamp from_ns = footage.exposure_ns.at(first.stamp_ns);
    const auto point = simulator.TrueScenePoint(camera, from_ns, first.pixel);
    if (!point) continue;
    ++judgement.num_judged;
    judgement.num_moving += point->is_moving ? 1 : 0;
    judgement.num_own_vehicle += point->is_own_vehicle ? 1 : 0;
    const bool is_at_edge = IsAtEdge(simulator, camera, from_ns, first.pixel, *point);
    judgement.num_at_edge += is_at_edge ? 1 : 0;
    bool is_gross = false;
    for (std::size_t k = 1; k < track.observations.size(); ++k) {
      const TrackObservation& observation = track.observations[k];
      const Timestamp to_ns = footage.exposure_ns.at(observation.stamp_ns);
      const auto moved = simulator.PointAtTime(*point, from_ns, to_ns);
      if (!moved) continue;
      const auto pixel = simulator.TruePixel(camera, to_ns, *moved);
      const Eigen::Vector2d error =
          pixel ? Eigen::Vector2d(*pixel - observation.pixel) : Eigen::Vector2d(1e3, 1e3);
      judgement.error_px.push_back(error.norm());
      judgement.aged[static_cast<int>(k)].push_back(error.norm());
      if (!is_at_edge) judgement.aged_off_edges[static_cast<int>(k)].push_back(error.norm());
      if (pixel) {
        const auto along = EpipolarDirection(simulator, camera, from_ns, to_ns, *moved);
        if (along) {
          const double across = error.x() * along->y() - error.y() * along->x();
          judgement.aged_across[static_cast<int>(k)].push_back(std::abs(across));
        }
      }
      const Eigen::Matrix2d covariance = observation.covariance_px2 + first.covariance_px2;
      judgement.normalised.push_back(0.5 * error.dot(covariance.inverse() * error));
      is_gross = is_gross || error.norm() > 2.0;
    }
    judgement.num_gross += is_gross ? 1 : 0;
  }
  return judgement;
}

void PrintByAge(const std::map<int, std::vector<double>>& error_px) {
  for (const int age : {1, 2, 4, 9, 14, 19, 29}) {
    const auto aged = error_px.find(age);
    if (aged == error_px.end()) continue;
    std::printf("  %d: %.3f (%zu)", age + 1, Quantile(aged->second, 0.95), aged->second.size());
  }
}

void Print(const std::string& name, const Judgement& judgement, int num_images, double add_ms,
           double segment_ms) {
  const double tracks = std::max(1, judgement.num_tracks);
  std::vector<double> live;
  double live_sum = 0.0;
  for (const auto& [stamp_ns, count] : judgement.live) {
    live.push_back(count);
    live_sum += count;
  }
  std::printf("%s: %d tracks, mean length %.1f, live a frame mean %.0f min %.0f\n", name.c_str(),
              judgement.num_tracks, judgement.length_sum / tracks, live_sum / num_images,
              Quantile(live, 0.0));
  std::printf(
      "  error px median %.3f 95%% %.3f; tracks off by over 2 px %.2f %%; moving %.2f %%, "
      "own vehicle %d\n",
      Quantile(judgement.error_px, 0.5), Quantile(judgement.error_px, 0.95),
      100.0 * judgement.num_gross / std::max(1, judgement.num_judged),
      100.0 * judgement.num_moving / tracks, judgement.num_own_vehicle);
  std::printf("  95%% by observation:");
  PrintByAge(judgement.aged);
  std::printf("\n  the same without the %.1f %% at depth edges:",
              100.0 * judgement.num_at_edge / std::max(1, judgement.num_judged));
  PrintByAge(judgement.aged_off_edges);
  std::printf("\n  across the epipolar line:");
  PrintByAge(judgement.aged_across);
  std::printf("\n  error^2 / stated variance, median %.2f (1.39/2 = 0.69 if honest)",
              Quantile(judgement.normalised, 0.5));
  std::printf("; CPU ms a frame: live %.1f, final %.1f\n", add_ms, segment_ms);
  std::fflush(stdout);
}

/// Another program's tracks of one camera, a sighting a line: track, image (0 is the first), x, y
/// (0, 0 is the middle of the first pixel). Those of fewer than three images are left out.
Result<std::vector<Track>> ReadTracks(const std::string& path, const Footage& footage) {
  std::ifstream file(path);
  if (!file) return Status::NotFound(path + ": cannot be read");
  std::map<std::int64_t, std::map<Timestamp, TrackObservation>> sightings;
  std::int64_t id = 0;
  std::size_t image = 0;
  TrackObservation observation;
  while (file >> id >> image >> observation.pixel.x() >> observation.pixel.y()) {
    if (image >= footage.images.size()) {
      return Status::InvalidArgument(path + ": there is no image " + std::to_string(image));
    }
    observation.stamp_ns = footage.images[image].stamp_ns;
    sightings[id].emplace(observation.stamp_ns, observation);
  }
  if (!file.eof()) return Status::InvalidArgument(path + ": not lines of: track image x y");
  std::vector<Track> tracks;
  for (const auto& [track_id, seen] : sightings) {
    if (seen.size() < 3) continue;
    tracks.emplace_back();
    tracks.back().id = track_id;
    for (const auto& [stamp_ns, sighting] : seen) tracks.back().observations.push_back(sighting);
  }
  return tracks;
}

double CpuMs() { return 1e3 * static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

Status Run(const Arguments& arguments) {
  TrackingOptions options;
  if (!arguments.config.empty()) {
    SCENECALIB_RETURN_IF_ERROR(ReadOptionsYaml(arguments.config, &options));
  }
  const Result<Rig> rig = arguments.rig.empty() ? RigWithNarrowCamera() : ReadRig(arguments.rig);
  if (!rig.ok()) return rig.status();
  const Result<Simulator> simulator = Simulator::Create(*rig, arguments.simulation);
  if (!simulator.ok()) return simulator.status();
  if (!arguments.tracks.empty() && arguments.cameras.size() != 1) {
    return Status::InvalidArgument("--tracks are one camera's: name it by --camera");
  }
  for (int c = 0; c < static_cast<int>(rig->cameras.size()); ++c) {
    const CameraConfig& camera = rig->cameras[static_cast<std::size_t>(c)];
    // All cameras are simulated, whichever are looked at: each draws its clock from one stream.
    if (std::find(arguments.cameras.begin(), arguments.cameras.end(), camera.name) ==
        arguments.cameras.end()) {
      continue;
    }
    const Footage footage = Film(*simulator, c, arguments);
    const auto num_images = static_cast<int>(footage.images.size());
    if (!arguments.tracks.empty()) {
      const Result<std::vector<Track>> tracks = ReadTracks(arguments.tracks, footage);
      if (!tracks.ok()) return tracks.status();
      Print(camera.name, Judge(*simulator, c, footage, *tracks), num_images, 0.0, 0.0);
      continue;
    }
    CameraTracker tracker(camera.name, camera.model, options);
    const double start_ms = CpuMs();
    for (const GrayImage& image : footage.images) {
      const Result<FrameTracking> frame = tracker.AddImage(image);
      if (!frame.ok()) return frame.status();
    }
    const double added_ms = CpuMs();
    const CameraSegment segment = tracker.Segment();
    const double done_ms = CpuMs();
    Print(camera.name, Judge(*simulator, c, footage, segment.tracks), num_images,
          (added_ms - start_ms) / num_images, (done_ms - added_ms) / num_images);
    for (const std::string& warning : segment.warnings) std::printf("  %s\n", warning.c_str());
  }
  return Status::Ok();
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("Accuracy of feature tracks on a simulated drive.");
  scenecalib::Arguments arguments;
  scenecalib::SimulationOptions& simulation = arguments.simulation;
  simulation.duration_s = 4.0;
  simulation.camera.color = false;
  app.add_option("--camera", arguments.cameras, "narrow, front, left, fisheye");
  app.add_option("--rig", arguments.rig, "rig file, instead of the built-in cameras");
  app.add_option("--world", simulation.world.kind, scenecalib::KnownWorldKinds());
  app.add_option("--drive", simulation.drive.kind, "turns, gentle or straight");
  app.add_option("--seed", simulation.seed, "of the world and drive");
  app.add_option("--duration", simulation.duration_s, "seconds");
  app.add_option("--speed", simulation.drive.speed_m_s, "mean, m/s");
  app.add_option("--rate", simulation.camera.rate_hz, "images per second");
  app.add_option("--cars", simulation.world.num_moving_cars, "that drive");
  app.add_option("--night", arguments.night_stops, "stops by which the exposure is down");
  app.add_option("--night-noise", arguments.night_noise_levels, "grey levels, at night");
  app.add_option("--cache", arguments.cache_directory, "directory to keep the images in");
  app.add_option("--config", arguments.config, "overrides of the tracking options");
  app.add_option("--tracks", arguments.tracks,
                 "another program's, judged instead: lines of track, image, x, y");
  CLI11_PARSE(app, argc, argv);
  const scenecalib::Status status = scenecalib::Run(arguments);
  if (!status.ok()) {
    std::fprintf(stderr, "%s\n", status.message().c_str());
    return 1;
  }
  return 0;
}
