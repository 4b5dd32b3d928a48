#include "scenecalib/ros/simulate.h"

#include <ros/init.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <optional>
#include <string>
#include <system_error>
#include <vector>

#include "scenecalib/io/atomic_file.h"
#include "scenecalib/io/options_yaml.h"
#include "scenecalib/io/rig_yaml.h"
#include "scenecalib/io/trajectory_tum.h"
#include "scenecalib/ros/log_sink.h"
#include "scenecalib/ros/recording_writer.h"
#include "scenecalib/ros/terminal_progress.h"
#include "scenecalib/simulation/simulator.h"

namespace scenecalib {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::string rig;
  std::string output;
  std::string config;
  std::optional<int> seed;
  std::optional<double> duration_s;
};

void Declare(CLI::App* app, Arguments* arguments) {
  app->add_option("--output", arguments->output, "directory for recording and truth")->required();
  app->add_option("--rig", arguments->rig, "rig file to simulate (default: the built-in rig)");
  app->add_option("--config", arguments->config, "YAML file with options that differ from default");
  app->add_option("--seed", arguments->seed, "of every random choice");
  app->add_option("--duration", arguments->duration_s, "of the recording, seconds");
}

Result<SimulationOptions> ReadOptions(const Arguments& arguments) {
  SimulationOptions options;
  if (!arguments.config.empty()) {
    SCENECALIB_RETURN_IF_ERROR(ReadOptionsYaml(arguments.config, &options));
  }
  if (arguments.seed) options.seed = *arguments.seed;
  if (arguments.duration_s) options.duration_s = *arguments.duration_s;
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  return options;
}

/// One line per image: camera, stamp of the message, true time of exposure on the lidar's clock.
std::string FormatImageTimes(const Simulator& simulator) {
  std::string text = "# camera stamp_ns exposure_ns (camera clock, lidar clock)\n";
  for (const ScheduledMeasurement& item : simulator.schedule()) {
    if (item.kind != MeasurementKind::kImage) continue;
    text += simulator.true_rig().cameras[static_cast<std::size_t>(item.camera)].name + " " +
            std::to_string(item.stamp_ns) + " " + std::to_string(item.exposure_ns) + "\n";
  }
  return text;
}

Status Run(const Arguments& arguments) {
  const Result<SimulationOptions> options = ReadOptions(arguments);
  if (!options.ok()) return options.status();
  const Result<Rig> rig = arguments.rig.empty() ? DefaultRig() : ReadRig(arguments.rig);
  if (!rig.ok()) return rig.status();
  const Result<Simulator> simulator = Simulator::Create(*rig, *options);
  if (!simulator.ok()) return simulator.status();
  const Result<Rig> start = simulator->PerturbedRig();
  if (!start.ok()) return start.status();

  const fs::path directory = arguments.output;
  std::error_code error;
  fs::create_directories(directory, error);
  if (error) {
    return Status::Unavailable("cannot make " + arguments.output + ": " + error.message());
  }
  TerminalProgress terminal;
  SCENECALIB_RETURN_IF_ERROR(
      WriteRecording(*simulator, (directory / "recording.bag").string(),
                     [&terminal](const Progress& progress) { return terminal(progress); }));
  SCENECALIB_RETURN_IF_ERROR(WriteRig((directory / "truth.yaml").string(), simulator->true_rig()));
  SCENECALIB_RETURN_IF_ERROR(WriteRig((directory / "rig_initial.yaml").string(), *start));
  SCENECALIB_RETURN_IF_ERROR(WriteTrajectoryTum((directory / "truth_trajectory.tum").string(),
                                                simulator->true_map_from_lidar()));
  return WriteFileAtomically((directory / "truth_image_times.txt").string(),
                             FormatImageTimes(*simulator));
}

}  // namespace

int RunSimulate(int argc, char** argv) {
  std::vector<std::string> own_arguments;  // without roslaunch's __name:= and __log:=
  ros::removeROSArgs(argc, argv, own_arguments);
  std::vector<std::string> reversed(own_arguments.rbegin(), own_arguments.rend() - 1);
  InstallTerminalLogSink();
  CLI::App app("Simulates a recording of a driving vehicle, with its exact truth.");
  Arguments arguments;
  Declare(&app, &arguments);
  try {
    app.parse(reversed);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 1;
  }
  Status status;
  try {
    status = Run(arguments);
  } catch (const std::exception& error) {  // memory, file system: nothing of ours throws
    status = Status::Unavailable(error.what());
  }
  if (!status.ok()) std::fprintf(stderr, "simulate: %s\n", status.message().c_str());
  return status.ok() ? 0 : 1;
}

}  // namespace scenecalib
