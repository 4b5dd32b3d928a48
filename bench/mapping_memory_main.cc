// Peak memory and time of mapping a simulated drive of a kilometre and of two, as a vehicle would:
// scans come one by one, then the map is built. Run one length per process: peaks do not go down.

#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <string>

#include "bench/simulated_drive.h"
#include "scenecalib/evaluation/trajectory_error.h"
#include "scenecalib/mapping/segment_mapper.h"

namespace scenecalib {
namespace {

double PeakMiB() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;
}

class Stopwatch {
 public:
  double Seconds() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

void ReportMap(const SimulatedDrive& drive, const MappingResult& result) {
  std::printf("  %d of %d scans used, %d forgotten; %.0f m; %zu surfels, %zu triangles\n",
              result.report.num_scans_used, result.report.num_scans_in,
              result.report.num_scans_dropped_at_bound, result.report.path_length_m,
              result.map.surfels.size(), result.map.ground.triangles.size());
  for (const std::string& warning : result.report.warnings) std::printf("  %s\n", warning.c_str());
  const Trajectory& truth = drive.simulator().true_map_from_lidar();
  const auto errors = CompareRelativeMotion(truth, result.map.map_from_lidar, {0.5, 1.0, 4.0});
  if (errors.ok()) {
    for (const RelativeMotionError& error : *errors) {
      std::printf("  %.1f s: %.2f mm %.4f deg", error.window_s, 1e3 * error.translation_m,
                  180.0 / M_PI * error.rotation_rad);
    }
  }
  std::printf("\n  stated of itself:");
  for (const RelativeMotionSigma& sigma : result.map.relative_motion) {
    std::printf("  %.1f s: %.2f mm %.4f deg", sigma.window_s, 1e3 * sigma.translation_m,
                180.0 / M_PI * sigma.rotation_rad);
  }
  const auto drift = CompareDrift(truth, result.map.map_from_lidar, 300.0);
  if (drift.ok()) std::printf("\n  drift over 300 m: %.4f %%", 100.0 * drift->translation_share);
  std::printf("\n");
}

Status Run(const DriveSpec& spec, bool with_imu) {
  const Result<SimulatedDrive> drive = SimulatedDrive::Create(spec);
  if (!drive.ok()) return drive.status();
  std::printf("%s: %d scans, world %.0f MiB\n", Describe(spec).c_str(), drive->num_scans(),
              PeakMiB());
  Rig rig = drive->rig();
  if (!with_imu) rig.imu.reset();
  rig.odometry.reset();
  SegmentMapper mapper(rig, MappingOptions());
  std::size_t next_imu = 0;
  double odometry_s = 0.0;
  for (int i = 0; i < drive->num_scans(); ++i) {
    const LidarScan scan = drive->Scan(i);
    const Timestamp end_ns = AddSeconds(scan.stamp_ns, 0.2);
    for (; next_imu < drive->imu().size() && drive->imu()[next_imu].stamp_ns < end_ns; ++next_imu) {
      mapper.AddImu(drive->imu()[next_imu]);
    }
    const Stopwatch watch;
    const auto registration = mapper.AddScan(scan);
    odometry_s += watch.Seconds();
    if (!registration.ok()) std::printf("  %s\n", registration.status().message().c_str());
  }
  std::printf("  odometry: %.1f s, peak %.0f MiB\n", odometry_s, PeakMiB());
  std::string stage;
  const Stopwatch watch;
  double since_s = 0.0;
  const auto report_stage = [&](const std::string& next) {
    if (next == stage) return;
    if (!stage.empty()) {
      std::printf("  %s: %.1f s, peak %.0f MiB\n", stage.c_str(), watch.Seconds() - since_s,
                  PeakMiB());
      std::fflush(stdout);
    }
    since_s = watch.Seconds();
    stage = next;
  };
  const auto result = mapper.BuildMap([&](const Progress& progress) {
    report_stage(progress.stage);
    return true;
  });
  report_stage("");
  if (!result.ok()) return result.status();
  ReportMap(*drive, *result);
  return Status::Ok();
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("Peak memory and time of mapping a simulated drive.");
  scenecalib::DriveSpec spec;
  spec.duration_s = 100.0;
  spec.speed_m_s = 10.0;
  spec.drive = "gentle";
  bool no_imu = false;
  app.add_option("--world", spec.world, scenecalib::KnownWorldKinds());
  app.add_option("--seed", spec.seed, "of the world and drive");
  app.add_option("--drive", spec.drive, "turns, gentle or straight");
  app.add_option("--duration", spec.duration_s, "seconds; ten scans each");
  app.add_option("--speed", spec.speed_m_s, "mean, m/s");
  app.add_option("--cache", spec.cache_directory, "directory to keep the scans in");
  app.add_flag("--no-imu", no_imu, "lidar only");
  CLI11_PARSE(app, argc, argv);
  const scenecalib::Status status = scenecalib::Run(spec, !no_imu);
  if (!status.ok()) {
    std::fprintf(stderr, "%s\n", status.message().c_str());
    return 1;
  }
  return 0;
}
