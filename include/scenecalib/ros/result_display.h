#pragma once

#include "scenecalib/pipeline/calibration_pipeline.h"

namespace scenecalib {

/// Publishes an offline run's result on the topics of the live nodes (latched), so that
/// rviz/calibration.rviz shows it, and tf map -> lidar -> cameras; returns when ROS shuts down.
/// Needs a ROS master: waits for it.
void ShowResult(const PipelineResult& result);

}  // namespace scenecalib
