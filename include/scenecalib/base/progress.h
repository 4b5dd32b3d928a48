#pragma once

#include <functional>
#include <string>

namespace scenecalib {

/// Progress of one stage: fraction is in [0, 1] and does not decrease within a stage.
struct Progress {
  std::string stage;  ///< "mapping: odometry", "tracking cam_front", ...
  double fraction = 0.0;
  std::string detail;  ///< a rate or a count for a person, may be empty
};

/// Called by long-running stages. Returning false asks the stage to stop: it then returns
/// Status::Cancelled. An empty function means nobody watches.
using ProgressCallback = std::function<bool(const Progress&)>;

/// Calls the callback when there is one; true means go on.
inline bool ReportProgress(const ProgressCallback& callback, const std::string& stage,
                           double fraction, const std::string& detail = {}) {
  return !callback || callback(Progress{stage, fraction, detail});
}

}  // namespace scenecalib
