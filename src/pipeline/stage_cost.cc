#include "scenecalib/pipeline/stage_cost.h"

#include <fstream>
#include <sstream>
#include <utility>

namespace scenecalib {
namespace {

/// Linux resets the high-water mark on request (proc(5), clear_refs); elsewhere the peak is that of
/// the whole run so far.
void ResetPeakMemory() { std::ofstream("/proc/self/clear_refs") << "5"; }

double PeakMemoryMib() {
  std::ifstream status("/proc/self/status");
  std::string line;
  while (std::getline(status, line)) {
    if (line.rfind("VmHWM:", 0) != 0) continue;
    std::istringstream fields(line.substr(6));
    double kib = 0.0;
    fields >> kib;
    return kib / 1024.0;
  }
  return 0.0;
}

}  // namespace

StageTimer::StageTimer(std::string stage)
    : stage_(std::move(stage)), start_(std::chrono::steady_clock::now()) {
  ResetPeakMemory();
}

StageCost StageTimer::Stop() const {
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start_;
  return {stage_, elapsed.count(), PeakMemoryMib()};
}

}  // namespace scenecalib
