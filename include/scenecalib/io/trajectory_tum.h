#pragma once

#include <string>

#include "scenecalib/base/status.h"
#include "scenecalib/geometry/trajectory.h"

namespace scenecalib {

/// Trajectories in the text format of the TUM benchmark, one pose a line,
///
///   stamp_s x y z qx qy qz qw
///
/// with map_from_lidar in metres and the stamp in seconds, read to the nanosecond. Lines that start
/// with # are comments. NotFound for a missing file; InvalidArgument naming file and line for a
/// line that is not eight numbers, a quaternion whose norm is off by more than 1e-3, or stamps that
/// do not increase.
Result<Trajectory> ReadTrajectoryTum(const std::string& path);
/// As ReadTrajectoryTum, from text; `source_name` stands for the file in messages.
Result<Trajectory> ParseTrajectoryTum(const std::string& text, const std::string& source_name);

/// Every number reads back as it was.
std::string FormatTrajectoryTum(const Trajectory& trajectory);
Status WriteTrajectoryTum(const std::string& path, const Trajectory& trajectory);

}  // namespace scenecalib
