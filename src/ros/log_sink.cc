#include "scenecalib/ros/log_sink.h"

#include <ros/console.h>

#include <cstdio>
#include <string>

#include "scenecalib/base/log.h"

namespace scenecalib {

void InstallRosLogSink() {
  SetLogSink([](LogSeverity severity, const std::string& message) {
    switch (severity) {
      case LogSeverity::kDebug:
        ROS_DEBUG_STREAM(message);
        break;
      case LogSeverity::kInfo:
        ROS_INFO_STREAM(message);
        break;
      case LogSeverity::kWarning:
        ROS_WARN_STREAM(message);
        break;
      case LogSeverity::kError:
        ROS_ERROR_STREAM(message);
        break;
    }
  });
}

void InstallTerminalLogSink() {
  SetLogSink([](LogSeverity severity, const std::string& message) {
    if (severity == LogSeverity::kDebug) return;
    const char* prefix = severity == LogSeverity::kError     ? "error: "
                         : severity == LogSeverity::kWarning ? "warning: "
                                                             : "";
    std::fprintf(stderr, "%s%s\n", prefix, message.c_str());
  });
}

}  // namespace scenecalib
