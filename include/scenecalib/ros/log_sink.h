#pragma once

namespace scenecalib {

/// Sends the library's log lines to the ROS console (nodes).
void InstallRosLogSink();

/// Sends them to standard error (programs without a master).
void InstallTerminalLogSink();

}  // namespace scenecalib
