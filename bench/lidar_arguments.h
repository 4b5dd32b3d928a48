#pragma once

#include <CLI/CLI.hpp>

#include "scenecalib/simulation/simulation_options.h"

namespace scenecalib {

/// The lidar's properties that benchmarks vary, as arguments.
inline void AddLidarArguments(CLI::App* app, SimulatedLidarOptions* lidar) {
  app->add_option("--rings", lidar->rings, "of the lidar");
  app->add_option("--columns", lidar->columns, "of the lidar");
  app->add_option("--ring-range-m", lidar->ring_range_m, "deviation of its lasers' range errors");
  app->add_option("--ring-angle-deg", lidar->ring_angle_deg, "of their angles' errors");
  app->add_option("--beam-mrad", lidar->beam_mrad, "divergence of its beams");
}

}  // namespace scenecalib
