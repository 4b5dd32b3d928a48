// Accuracy of the mapping against the simulator's exact truth: trajectory (with and without IMU),
// drift and what the mapping states of itself. One line per drive and kind of prior.

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "bench/lidar_arguments.h"
#include "bench/simulated_drive.h"
#include "scenecalib/evaluation/trajectory_error.h"
#include "scenecalib/io/options_yaml.h"
#include "scenecalib/mapping/segment_mapper.h"

namespace scenecalib {
namespace {

constexpr double kDegrees = 180.0 / M_PI;

struct Arguments {
  std::vector<std::string> worlds = {"street", "suburb", "plaza"};
  std::vector<int> seeds = {1};
  DriveSpec drive;
  MappingOptions mapping;
};

struct Priors {
  bool imu = true;
  bool odometry = true;
};

Result<MappingResult> Map(const SimulatedDrive& drive, const MappingOptions& options,
                          const Priors& priors) {
  Rig rig = drive.rig();
  if (!priors.imu) rig.imu.reset();
  if (!priors.odometry) rig.odometry.reset();
  SegmentMapper mapper(rig, options);
  if (priors.imu) {
    for (const ImuSample& sample : drive.imu()) mapper.AddImu(sample);
  }
  if (priors.odometry) {
    for (const OdometrySample& sample : drive.odometry()) mapper.AddOdometry(sample);
  }
  for (int i = 0; i < drive.num_scans(); ++i) {
    const Result<ScanRegistration> registration = mapper.AddScan(drive.Scan(i));
    if (!registration.ok()) std::printf("  %s\n", registration.status().message().c_str());
  }
  return mapper.BuildMap({});
}

Status ReportTrajectory(const SimulatedDrive& drive, const MappingResult& result) {
  const auto errors = CompareRelativeMotion(drive.simulator().true_map_from_lidar(),
                                            result.map.map_from_lidar, {0.1, 0.5, 1.0, 4.0});
  if (!errors.ok()) return errors.status();
  for (const RelativeMotionError& error : *errors) {
    std::printf("  %.1f s: %.2f mm %.4f deg (worst %.2f mm)", error.window_s,
                1e3 * error.translation_m, kDegrees * error.rotation_rad,
                1e3 * error.max_translation_m);
  }
  std::printf("\n  stated of itself:");
  for (const RelativeMotionSigma& sigma : result.map.relative_motion) {
    std::printf("  %.1f s: %.2f mm %.4f deg", sigma.window_s, 1e3 * sigma.translation_m,
                kDegrees * sigma.rotation_rad);
  }
  std::printf("; surfel thickness %.2f -> %.2f mm; lasers moved by %.1f mm, %.4f deg\n",
              1e3 * result.report.thickness_before_m, 1e3 * result.report.thickness_after_m,
              1e3 * result.report.laser_range_m, kDegrees * result.report.laser_elevation_rad);
  const auto drift =
      CompareDrift(drive.simulator().true_map_from_lidar(), result.map.map_from_lidar, 300.0);
  if (drift.ok()) std::printf("  drift over 300 m: %.4f %%\n", 100.0 * drift->translation_share);
  return Status::Ok();
}

Status Run(const DriveSpec& spec, const MappingOptions& options) {
  const Result<SimulatedDrive> drive = SimulatedDrive::Create(spec);
  if (!drive.ok()) return drive.status();
  for (const Priors& priors : {Priors{true, true}, Priors{true, false}, Priors{false, false}}) {
    std::printf("%s, %s IMU, %s odometry\n", Describe(spec).c_str(), priors.imu ? "with" : "no",
                priors.odometry ? "with" : "no");
    const Result<MappingResult> result = Map(*drive, options, priors);
    if (!result.ok()) return result.status();
    for (const std::string& warning : result->report.warnings) {
      std::printf("  %s\n", warning.c_str());
    }
    SCENECALIB_RETURN_IF_ERROR(ReportTrajectory(*drive, *result));
    std::fflush(stdout);
  }
  return Status::Ok();
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("Accuracy of the mapping on simulated drives.");
  scenecalib::Arguments arguments;
  app.add_option("--world", arguments.worlds, scenecalib::KnownWorldKinds());
  app.add_option("--seed", arguments.seeds, "of the worlds and drives");
  app.add_option("--drive", arguments.drive.drive, "turns, gentle or straight");
  app.add_option("--duration", arguments.drive.duration_s, "seconds");
  app.add_option("--speed", arguments.drive.speed_m_s, "mean, m/s");
  scenecalib::AddLidarArguments(&app, &arguments.drive.lidar);
  app.add_option("--cache", arguments.drive.cache_directory, "directory to keep the scans in");
  std::string config;
  app.add_option("--config", config, "options of the mapping, YAML");
  CLI11_PARSE(app, argc, argv);
  if (!config.empty()) {
    const scenecalib::Status status = scenecalib::ReadOptionsYaml(config, &arguments.mapping);
    if (!status.ok()) {
      std::fprintf(stderr, "%s\n", status.message().c_str());
      return 1;
    }
  }
  for (const std::string& world : arguments.worlds) {
    for (const int seed : arguments.seeds) {
      arguments.drive.world = world;
      arguments.drive.seed = seed;
      const scenecalib::Status status = scenecalib::Run(arguments.drive, arguments.mapping);
      if (!status.ok()) {
        std::fprintf(stderr, "%s\n", status.message().c_str());
        return 1;
      }
    }
  }
  return 0;
}
