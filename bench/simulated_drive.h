#pragma once

#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/simulation/simulator.h"
#include "scenecalib/simulation/world.h"

namespace scenecalib {

/// A simulated drive for benchmarks: the lidar's side of a recording with its exact truth.
struct DriveSpec {
  std::string world = "street";
  std::string drive = "turns";
  int seed = 1;
  double duration_s = 10.0;
  SimulatedLidarOptions lidar;
  double speed_m_s = 8.0;
  int num_moving_cars = 3;
  std::string rig;  ///< rig file; empty: DefaultRig()
  SimulatedStartOptions start;
  /// Scans and images once made are kept here as files and read again by a later run; empty: not
  /// kept.
  std::string cache_directory;
};

/// "street/turns seed 1, 10 s, 64 x 1024"
std::string Describe(const DriveSpec& spec);

/// Casts scans on demand, one at a time, so that a kilometre needs no memory.
class SimulatedDrive {
 public:
  static Result<SimulatedDrive> Create(const DriveSpec& spec);

  const Simulator& simulator() const { return simulator_; }
  const Rig& rig() const { return simulator_.true_rig(); }
  int num_scans() const { return simulator_.num_scans(); }
  LidarScan Scan(int index) const;
  /// Grey, as decoded from the JPEG that a recording holds.
  GrayImage Image(int camera, int index) const;
  const std::vector<ImuSample>& imu() const { return imu_; }
  const std::vector<OdometrySample>& odometry() const { return odometry_; }

 private:
  explicit SimulatedDrive(Simulator simulator) : simulator_(std::move(simulator)) {}

  Simulator simulator_;
  std::string cache_;
  std::vector<ImuSample> imu_;
  std::vector<OdometrySample> odometry_;
};

}  // namespace scenecalib
