#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include "pose_table.h"
#include "scenecalib/geometry/trajectory.h"
#include "scenecalib/mapping/laser_correction.h"
#include "scenecalib/mapping/lidar_odometry.h"
#include "scenecalib/mapping/packed_scan.h"
#include "scenecalib/mapping/pose_spline.h"
#include "scenecalib/mapping/surface_builder.h"

namespace scenecalib {

/// A scan as a segment keeps it, with where the odometry found it.
struct BufferedScan {
  PackedScan scan;
  SweepRegistration registration;
};
using BufferedScans = std::vector<std::shared_ptr<const BufferedScan>>;

/// Metres travelled; jitter of a standing vehicle does not add up.
double PathLength(const std::vector<TimedPose>& poses);

/// Median over some of the scans.
double AirborneShare(const BufferedScans& scans);

/// The scans of the longest stretch over which tracking held.
BufferedScans LongestStretch(const std::deque<std::shared_ptr<const BufferedScan>>& scans);

/// The odometry's poses of all sweeps in one sequence. Where a sweep reaches into the next one's
/// time it yields.
std::vector<TimedPose> OdometryPoses(const BufferedScans& scans);

/// So many of the scans that their points keep to the bound, evenly along the way; a standing
/// vehicle's scans, which see the same again, count little.
BufferedScans SpreadForSurfaces(const BufferedScans& scans, const PoseTable& table, int max_points);

/// The scan's points in the map, each at its own time, their lasers' errors taken off.
RegisteredScan PlaceInMap(const BufferedScan& buffered, const LaserCorrection& lasers,
                          const PoseTable& table);

/// The spline's poses in the map frame: origin at the first pose, z against gravity where it was
/// measured (else the odometry's frame has z on the ground's normal).
std::vector<TimedPose> LeveledPoses(const PoseSpline& spline,
                                    const std::optional<Eigen::Vector3d>& gravity);

}  // namespace scenecalib
