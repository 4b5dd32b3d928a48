#pragma once

#include <functional>
#include <string>

namespace scenecalib {

enum class LogSeverity { kDebug, kInfo, kWarning, kError };

/// Where the library's log lines go. The core never prints: an executable installs a sink (ROS
/// console, terminal, test collector). Thread-safe.
using LogSink = std::function<void(LogSeverity, const std::string& message)>;

/// Replaces the process-wide sink and returns the previous one; an empty sink drops every line.
LogSink SetLogSink(LogSink sink);

/// Hands one line, without a trailing newline, to the sink.
void Log(LogSeverity severity, const std::string& message);

}  // namespace scenecalib
