#pragma once

namespace scenecalib {

/// The program calibrate_bag (docs/ros_api.md): reads bags directly, without a ROS master, and
/// calibrates. Returns its exit status: 0 every camera accepted, 2 a result was written but at
/// least one camera was not accepted, 1 nothing could be calibrated and nothing was written.
int RunCalibrateBag(int argc, char** argv);

}  // namespace scenecalib
