// How often the lidar odometry starts wrong on a vehicle that moves already, without wheel
// odometry: the first scans of many simulated drives against the exact truth.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include "bench/simulated_drive.h"
#include "scenecalib/mapping/lidar_odometry.h"

namespace scenecalib {
namespace {

constexpr int kNumScans = 7;

struct Arguments {
  std::vector<std::string> worlds = {"street",     "suburb", "plaza",
                                     "industrial", "avenue", "village"};
  int num_seeds = 4;
  std::vector<int> rings = {16, 64};
  std::vector<double> speeds_m_s = {4.0, 8.0, 20.0};
  double max_error_m = 0.1;
  DriveSpec drive;
};

/// Largest error of a motion from one scan to the next.
double WorstStep_m(const SimulatedDrive& drive, bool with_imu) {
  Rig rig = drive.rig();
  rig.odometry.reset();
  if (!with_imu) rig.imu.reset();
  MotionPrior prior(rig);
  if (with_imu) {
    for (const ImuSample& sample : drive.imu()) prior.AddImu(sample);
  }
  LidarOdometry odometry{OdometryOptions()};
  const Trajectory& truth = drive.simulator().true_map_from_lidar();
  std::optional<Rigid3> last, true_last;
  double worst_m = 0.0;
  for (int i = 0; i < std::min(kNumScans, drive.num_scans()); ++i) {
    const auto placed = odometry.Register(drive.Scan(i), prior);
    if (!placed.ok()) continue;
    const auto true_pose = truth.Interpolate(placed->mid_ns());
    if (!true_pose) continue;
    if (last) {
      const Rigid3 step = last->Inverse() * placed->map_from_lidar;
      const Rigid3 true_step = true_last->Inverse() * *true_pose;
      worst_m = std::max(worst_m, (step.translation - true_step.translation).norm());
    }
    last = placed->map_from_lidar;
    true_last = true_pose;
  }
  return worst_m;
}

Status Run(const Arguments& arguments) {
  int num_starts = 0, num_wrong = 0;
  DriveSpec spec = arguments.drive;
  for (const std::string& world : arguments.worlds) {
    for (int seed = 1; seed <= arguments.num_seeds; ++seed) {
      for (const int rings : arguments.rings) {
        for (const double speed_m_s : arguments.speeds_m_s) {
          spec.world = world;
          spec.seed = seed;
          spec.lidar.rings = rings;
          spec.speed_m_s = speed_m_s;
          const Result<SimulatedDrive> drive = SimulatedDrive::Create(spec);
          if (!drive.ok()) return drive.status();
          for (const bool with_imu : {false, true}) {
            const double worst_m = WorstStep_m(*drive, with_imu);
            ++num_starts;
            if (worst_m <= arguments.max_error_m) continue;
            ++num_wrong;
            std::printf("%s, %s IMU: off by %.2f m\n", Describe(spec).c_str(),
                        with_imu ? "with" : "no", worst_m);
            std::fflush(stdout);
          }
        }
      }
    }
  }
  std::printf("%d of %d starts off by more than %.2f m from a scan to the next\n", num_wrong,
              num_starts, arguments.max_error_m);
  return Status::Ok();
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("Starts of the lidar odometry on simulated drives.");
  scenecalib::Arguments arguments;
  arguments.drive.drive = "gentle";
  arguments.drive.duration_s = 1.0;
  arguments.drive.lidar.ring_range_m = 0.015;
  arguments.drive.lidar.ring_angle_deg = 0.03;
  arguments.drive.lidar.beam_mrad = 2.0;
  app.add_option("--world", arguments.worlds, scenecalib::KnownWorldKinds());
  app.add_option("--seeds", arguments.num_seeds, "of each world, from 1 on");
  app.add_option("--rings", arguments.rings, "of the lidar, each in turn");
  app.add_option("--speed", arguments.speeds_m_s, "m/s, each in turn");
  app.add_option("--drive", arguments.drive.drive, "turns, gentle or straight");
  app.add_option("--max-error-m", arguments.max_error_m, "of a scan's motion, above it is wrong");
  CLI11_PARSE(app, argc, argv);
  const scenecalib::Status status = scenecalib::Run(arguments);
  if (!status.ok()) {
    std::fprintf(stderr, "%s\n", status.message().c_str());
    return 1;
  }
  return 0;
}
