#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/geometry/trajectory.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/sensor/rig.h"
#include "scenecalib/simulation/simulation_options.h"

namespace scenecalib {

enum class MeasurementKind { kScan, kImage, kImu, kOdometry };

/// One entry of the recording's timetable.
struct ScheduledMeasurement {
  MeasurementKind kind = MeasurementKind::kScan;
  int camera = -1;            ///< index into the rig, images only
  int index = 0;              ///< counts the measurements of this sensor from 0
  Timestamp stamp_ns = 0;     ///< of the message: a camera's own clock, otherwise the lidar clock
  Timestamp arrival_ns = 0;   ///< lidar clock: when the measurement is complete (a scan: its end)
  Timestamp exposure_ns = 0;  ///< lidar clock, true: of an image, or of a scan's first point
};

/// What a ray meets in the exact world.
struct ScenePoint {
  Eigen::Vector3d point_in_map_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal_in_map = Eigen::Vector3d::Zero();  ///< unit, against the ray
  double range_m = 0.0;                                     ///< from the ray's origin
  std::uint32_t object_id = 0;  ///< unique per object; triangles of one object share it
  bool is_moving = false;       ///< another car that drives
  bool is_own_vehicle = false;  ///< the recording vehicle's own body
  int moving_object = -1;       ///< which of the moving things it is, -1: none
};

/// A recording that never happened: a textured world, a drive through it, and what the sensors of a
/// rig would have measured, with the exact truth. Everything is a function of rig and options:
/// the same seed gives the same numbers with any number of threads. The map frame is the world's
/// (z up, the drive starts near the origin). Const calls are safe from several threads; RenderImage
/// and CastScan use all of TBB's threads themselves.
class Simulator {
 public:
  /// InvalidArgument for an option out of bounds, an unknown world or drive, or a camera without
  /// intrinsics (the message names it). Builds the world, so it may take a second.
  static Result<Simulator> Create(const Rig& true_rig, const SimulationOptions& options);
  ~Simulator();
  Simulator(Simulator&&) noexcept;
  Simulator& operator=(Simulator&&) noexcept;

  const Rig& true_rig() const;
  /// The rig to start a calibration from: options.start off the truth.
  Result<Rig> PerturbedRig() const;

  /// The true trajectory, 400 Hz, over the whole recording and a margin of a scan at both ends.
  const Trajectory& true_map_from_lidar() const;
  /// The exact pose at any stamp (lidar clock); none outside the trajectory.
  std::optional<Rigid3> MapFromLidar(Timestamp stamp_ns) const;

  /// Every measurement, by arrival_ns.
  const std::vector<ScheduledMeasurement>& schedule() const;
  int num_scans() const;
  int num_images(int camera) const;

  /// The index-th measurement of a sensor; index within the schedule.
  LidarScan CastScan(int index) const;
  ImuSample Imu(int index) const;
  OdometrySample Odometry(int index) const;
  /// CV_8UC3 (BGR) or, with color off, CV_8UC1.
  cv::Mat RenderImage(int camera, int index) const;
  /// The same view at any exposure time (lidar clock; the first row's) inside the trajectory;
  /// `index` seeds noise.
  cv::Mat RenderImageAt(int camera, Timestamp exposure_ns, int index) const;

  /// When a row of an image is exposed whose first row is at exposure_ns: the same, unless the
  /// camera has a rolling shutter.
  Timestamp RowTime(int camera, Timestamp exposure_ns, double row_px) const;

  /// What the pixel's ray meets in an image with that exposure time (lidar clock): the truth for
  /// tracks and surfaces. None for the sky and outside the lens or the trajectory.
  std::optional<ScenePoint> TrueScenePoint(int camera, Timestamp exposure_ns,
                                           const Eigen::Vector2d& pixel) const;
  /// Where that image shows a point of the map if nothing hides it; none outside the image.
  std::optional<Eigen::Vector2d> TruePixel(int camera, Timestamp exposure_ns,
                                           const Eigen::Vector3d& point_in_map_m) const;
  /// What a ray (unit direction) meets at a time, the own vehicle left out.
  std::optional<ScenePoint> CastRay(Timestamp stamp_ns, const Eigen::Vector3d& origin_in_map_m,
                                    const Eigen::Vector3d& direction_in_map) const;
  /// Where a scene point is at another time: itself, or carried along by its moving car or by the
  /// own vehicle. For exact flow.
  std::optional<Eigen::Vector3d> PointAtTime(const ScenePoint& point, Timestamp from_ns,
                                             Timestamp to_ns) const;

  std::size_t num_triangles() const;

 private:
  struct Impl;
  explicit Simulator(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// A rig to simulate with: front 70 degrees (plumb_bob), left 120 degrees (f-theta), front fisheye
/// 200 degrees (f-theta, its image circle inside the frame), a lidar on the roof, IMU, odometry.
Result<Rig> DefaultRig();

}  // namespace scenecalib
