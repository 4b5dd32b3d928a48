#pragma once

namespace scenecalib {

/// The program simulate (docs/ros_api.md): drives a rig through a simulated world and writes the
/// recording as a bag, with its exact truth. Needs no ROS master. Returns its exit status.
int RunSimulate(int argc, char** argv);

}  // namespace scenecalib
