#pragma once

#include <string>

#include "scenecalib/base/progress.h"
#include "scenecalib/base/status.h"
#include "scenecalib/simulation/simulator.h"

namespace scenecalib {

/// Writes everything that the simulator's schedule holds as a bag, with the message types that a
/// vehicle records: PointCloud2 (x, y, z, intensity, ring, time), Image or CompressedImage (JPEG)
/// when the topic ends in /compressed, CameraInfo where the lens is one that it can describe, Imu,
/// Odometry. Receipt times are when a measurement was complete. Unavailable when the disk refuses.
Status WriteRecording(const Simulator& simulator, const std::string& path,
                      const ProgressCallback& progress);

}  // namespace scenecalib
