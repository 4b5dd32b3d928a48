// Scans per second of the lidar odometry on a simulated street, without and with priors.
// items_per_second is scans per second; threads are TBB's.

#include <benchmark/benchmark.h>
#include <tbb/global_control.h>

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "bench/simulated_drive.h"
#include "scenecalib/mapping/lidar_odometry.h"

namespace scenecalib {
namespace {

struct Recording {
  Rig rig;
  std::vector<LidarScan> scans;
  std::vector<ImuSample> imu;
  std::vector<OdometrySample> odometry;
};

/// Cast once per kind of lidar; nullptr with the error reported.
const Recording* Record(int rings, int columns, benchmark::State* state) {
  static std::map<std::pair<int, int>, Recording> recordings;
  const auto known = recordings.find({rings, columns});
  if (known != recordings.end()) return &known->second;
  DriveSpec spec;
  spec.duration_s = 5.0;
  spec.lidar.rings = rings;
  spec.lidar.columns = columns;
  const Result<SimulatedDrive> drive = SimulatedDrive::Create(spec);
  if (!drive.ok()) {
    state->SkipWithError(drive.status().message().c_str());
    return nullptr;
  }
  Recording recording{drive->rig(), {}, drive->imu(), drive->odometry()};
  for (int i = 0; i < drive->num_scans(); ++i) recording.scans.push_back(drive->Scan(i));
  return &(recordings[{rings, columns}] = std::move(recording));
}

void BM_LidarOdometry(benchmark::State& state) {
  const Recording* recording =
      Record(static_cast<int>(state.range(0)), static_cast<int>(state.range(1)), &state);
  if (!recording) return;
  const bool with_priors = state.range(2) != 0;
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                  static_cast<std::size_t>(state.range(3)));
  MotionPrior prior(with_priors ? recording->rig : Rig());
  for (const ImuSample& sample : recording->imu) prior.AddImu(sample);
  for (const OdometrySample& sample : recording->odometry) prior.AddOdometry(sample);
  for (auto _ : state) {
    LidarOdometry odometry{OdometryOptions()};
    for (const LidarScan& scan : recording->scans) {
      const Result<SweepRegistration> sweep = odometry.Register(scan, prior);
      if (!sweep.ok() || !sweep->converged) state.SkipWithError("a scan was lost");
    }
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations()) *
                          static_cast<std::int64_t>(recording->scans.size()));
}

BENCHMARK(BM_LidarOdometry)
    ->ArgNames({"rings", "columns", "priors", "threads"})
    ->Args({64, 1024, 0, 1})
    ->Args({64, 1024, 0, 2})
    ->Args({64, 1024, 1, 2})
    ->Args({128, 1800, 0, 1})
    ->Args({128, 1800, 0, 2})
    ->Args({128, 1800, 1, 2})
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace scenecalib
