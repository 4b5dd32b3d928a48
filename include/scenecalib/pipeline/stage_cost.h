#pragma once

#include <chrono>
#include <string>

namespace scenecalib {

/// What a stage cost, for the report.
struct StageCost {
  std::string stage;
  double wall_s = 0.0;
  /// Highest resident memory of the process while the stage ran; 0 where the system does not tell.
  double peak_memory_mib = 0.0;
};

/// Measures a stage from construction to Stop().
class StageTimer {
 public:
  explicit StageTimer(std::string stage);
  StageCost Stop() const;

 private:
  std::string stage_;
  std::chrono::steady_clock::time_point start_;
};

}  // namespace scenecalib
