// Accuracy of the removal of moving objects: every return of simulated drives against what its ray
// truly met, the true trajectory given. For every drive the share of the moving returns that was
// removed and of the static ones that was lost, then the same for each moving car.

#include <tbb/parallel_for.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <map>
#include <string>
#include <vector>

#include "bench/point_labels.h"
#include "bench/simulated_drive.h"

namespace scenecalib {
namespace {

struct Arguments {
  std::vector<std::string> worlds = {"street", "suburb", "plaza"};
  std::vector<int> seeds = {1};
  std::vector<int> num_moving_cars = {3, 8};
  DriveSpec drive;
};

constexpr int kNotMoving = -1;

/// A scan in the true map, and which moving object each of its points is of.
struct LabelledScan {
  RegisteredScan scan;
  std::vector<int> object;
};

LabelledScan Label(const Simulator& simulator, const LidarScan& scan) {
  // A little more than the surfaces' own bound, so that they drop none.
  const double min_range_m = SurfaceOptions().min_range_m + 0.1;
  LabelledScan labelled;
  labelled.scan.stamp_ns = scan.stamp_ns;
  std::vector<LidarPoint> points;
  for (const LidarPoint& point : scan.points) {
    if (point.position_in_lidar_m.norm() > min_range_m) points.push_back(point);
  }
  labelled.scan.points.resize(points.size());
  labelled.object.assign(points.size(), kNotMoving);
  tbb::parallel_for(std::size_t{0}, points.size(), [&](std::size_t i) {
    const Timestamp stamp_ns = AddSeconds(scan.stamp_ns, points[i].time_offset_s);
    const auto map_from_lidar = simulator.MapFromLidar(stamp_ns);
    if (!map_from_lidar) return;
    const Eigen::Vector3d in_map = *map_from_lidar * points[i].position_in_lidar_m.cast<double>();
    labelled.scan.points[i] = {in_map.cast<float>(), points[i].time_offset_s, points[i].intensity};
    const Eigen::Vector3d direction = (in_map - map_from_lidar->translation).normalized();
    const auto hit = simulator.CastRay(stamp_ns, map_from_lidar->translation, direction);
    if (hit && hit->is_moving) labelled.object[i] = hit->moving_object;
  });
  const double half_sweep_s = points.empty() ? 0.0 : 0.5 * points.back().time_offset_s;
  labelled.scan.lidar_in_map_m =
      simulator.MapFromLidar(AddSeconds(scan.stamp_ns, half_sweep_s))->translation;
  return labelled;
}

struct Tally {
  int all = 0;
  int removed = 0;
  int as_ground = 0;

  void Add(ReturnFate fate) {
    ++all;
    if (fate == ReturnFate::kMoving) ++removed;
    if (fate == ReturnFate::kGround) ++as_ground;
  }
};

void Print(const char* name, const Tally& tally) {
  std::printf("  %s: %d returns, %.2f %% removed, %.2f %% taken for ground\n", name, tally.all,
              100.0 * tally.removed / tally.all, 100.0 * tally.as_ground / tally.all);
}

Status Run(const DriveSpec& spec) {
  const Result<SimulatedDrive> drive = SimulatedDrive::Create(spec);
  if (!drive.ok()) return drive.status();
  std::vector<RegisteredScan> scans;
  std::vector<std::vector<int>> objects;
  for (int i = 0; i < drive->num_scans(); ++i) {
    LabelledScan labelled = Label(drive->simulator(), drive->Scan(i));
    scans.push_back(std::move(labelled.scan));
    objects.push_back(std::move(labelled.object));
  }
  const auto fates = LabelReturns(scans, SurfaceOptions());
  Tally moving;
  Tally still;
  std::map<int, Tally> of_object;
  for (std::size_t s = 0; s < scans.size(); ++s) {
    for (std::size_t i = 0; i < fates[s].size(); ++i) {
      if (objects[s][i] == kNotMoving) {
        still.Add(fates[s][i]);
      } else {
        moving.Add(fates[s][i]);
        of_object[objects[s][i]].Add(fates[s][i]);
      }
    }
  }
  std::printf("%s\n", Describe(spec).c_str());
  Print("static", still);
  Print("moving", moving);
  for (const auto& [object, tally] : of_object) {
    Print(("car " + std::to_string(object)).c_str(), tally);
  }
  std::fflush(stdout);
  return Status::Ok();
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("Accuracy of the removal of moving objects on simulated drives.");
  scenecalib::Arguments arguments;
  app.add_option("--world", arguments.worlds, scenecalib::KnownWorldKinds());
  app.add_option("--seed", arguments.seeds, "of the worlds and drives");
  app.add_option("--cars", arguments.num_moving_cars, "how many other cars drive");
  app.add_option("--drive", arguments.drive.drive, "turns, gentle or straight");
  app.add_option("--duration", arguments.drive.duration_s, "seconds");
  app.add_option("--speed", arguments.drive.speed_m_s, "mean, m/s");
  app.add_option("--cache", arguments.drive.cache_directory, "directory to keep the scans in");
  CLI11_PARSE(app, argc, argv);
  for (const std::string& world : arguments.worlds) {
    for (const int seed : arguments.seeds) {
      for (const int num_cars : arguments.num_moving_cars) {
        arguments.drive.world = world;
        arguments.drive.seed = seed;
        arguments.drive.num_moving_cars = num_cars;
        const scenecalib::Status status = scenecalib::Run(arguments.drive);
        if (!status.ok()) {
          std::fprintf(stderr, "%s\n", status.message().c_str());
          return 1;
        }
      }
    }
  }
  return 0;
}
