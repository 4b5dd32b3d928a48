#pragma once

#include <chrono>
#include <map>
#include <string>

#include "scenecalib/base/progress.h"

namespace scenecalib {

/// Prints progress as lines "stage  percent  detail": one at the beginning of a stage, one when it
/// is done, and one a second between. Not thread-safe (CalibrationPipeline serialises its calls).
class TerminalProgress {
 public:
  /// Always true: a terminal stops a program by signal.
  bool operator()(const Progress& progress);

 private:
  struct Stage {
    double printed_fraction = -1.0;
    std::chrono::steady_clock::time_point printed_at;
  };
  std::map<std::string, Stage> stages_;
};

}  // namespace scenecalib
