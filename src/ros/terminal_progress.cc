#include "scenecalib/ros/terminal_progress.h"

#include <cstdio>

namespace scenecalib {

bool TerminalProgress::operator()(const Progress& progress) {
  Stage& stage = stages_[progress.stage];
  const auto now = std::chrono::steady_clock::now();
  const bool is_first = stage.printed_fraction < 0.0;
  const bool is_done = progress.fraction >= 1.0 && stage.printed_fraction < 1.0;
  const bool is_due = now - stage.printed_at >= std::chrono::seconds(1) &&
                      progress.fraction > stage.printed_fraction;
  if (is_first || is_done || is_due) {
    std::printf("[%-28s] %5.1f %%  %s\n", progress.stage.c_str(), 100.0 * progress.fraction,
                progress.detail.c_str());
    std::fflush(stdout);
    stage.printed_fraction = progress.fraction;
    stage.printed_at = now;
  }
  return true;
}

}  // namespace scenecalib
