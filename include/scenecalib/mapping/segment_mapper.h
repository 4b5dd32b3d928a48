#pragma once

#include <memory>
#include <string>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/base/progress.h"
#include "scenecalib/base/status.h"
#include "scenecalib/mapping/mapping_options.h"
#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// What happened to one scan in the odometry.
struct ScanRegistration {
  Timestamp stamp_ns = 0;
  Rigid3 map_from_lidar;  ///< at stamp_ns
  bool converged = false;
  int iterations = 0;
  int num_inliers = 0;
  double rms_m = 0.0;
  /// Unit vectors along which the scene fixes no translation (a tunnel, an open field).
  std::vector<Eigen::Vector3d> degenerate_directions_in_map;
};

/// Evidence of a finished map.
struct MappingReport {
  int num_scans_in = 0;
  int num_scans_used = 0;
  int num_scans_dropped_at_bound = 0;  ///< oldest scans forgotten because the buffer was full
  double path_length_m = 0.0;
  bool used_imu = false;
  bool used_odometry = false;
  double thickness_before_m = 0.0;  ///< median surfel thickness with the odometry's trajectory
  double thickness_after_m = 0.0;   ///< the same after the batch refinement
  /// What the lasers' points were corrected by, root mean square: range, elevation.
  double laser_range_m = 0.0;
  double laser_elevation_rad = 0.0;
  int num_points_moving = 0;    ///< removed as moving objects
  double airborne_share = 0.0;  ///< of a typical scan's returns: snow, rain, dust
  std::vector<std::string> warnings;
};

struct MappingResult {
  SceneMap map;
  MappingReport report;
};

/// Lidar mapping of one segment of driving (III-A): fed with measurements as they come, live or
/// from a bag; registers every scan on arrival (odometry) and, when asked, refines the trajectory
/// in continuous time and builds the surfaces. Not thread-safe: one owner feeds it.
///
/// Measurements may be a little out of order between sensors. Memory is bounded by
/// MappingOptions::buffer: at the bound the oldest scans are forgotten and counted.
class SegmentMapper {
 public:
  SegmentMapper(const Rig& rig, const MappingOptions& options);
  ~SegmentMapper();
  SegmentMapper(SegmentMapper&&) noexcept;
  SegmentMapper& operator=(SegmentMapper&&) noexcept;

  void AddImu(const ImuSample& sample);
  void AddOdometry(const OdometrySample& sample);

  /// Registers the scan against the local map. InvalidArgument for a scan whose stamp does not
  /// increase or that has too few points (it is then skipped and counted).
  Result<ScanRegistration> AddScan(const LidarScan& scan);

  /// Forgets everything.
  void Reset();

  int num_scans() const;

  /// A mapper with the same content; the scans themselves are shared, so this is quick. A live node
  /// builds the map of a clone in another thread while it goes on adding scans to the original.
  SegmentMapper Clone() const;

  /// The map of everything still buffered. InsufficientData without motion or with too few scans.
  Result<MappingResult> BuildMap(const ProgressCallback& progress) const;

  /// Test hook and study tool: as BuildMap, with a known trajectory instead of the estimated one,
  /// as uncertain as the lidar's own differs from it.
  Result<MappingResult> BuildMapWithTrajectory(const Trajectory& map_from_lidar,
                                               const ProgressCallback& progress) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace scenecalib
