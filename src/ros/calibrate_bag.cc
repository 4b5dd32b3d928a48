#include "scenecalib/ros/calibrate_bag.h"

#include <ros/init.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <optional>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/evaluation/result_table.h"
#include "scenecalib/io/options_yaml.h"
#include "scenecalib/io/rig_yaml.h"
#include "scenecalib/io/trajectory_tum.h"
#include "scenecalib/pipeline/artifacts.h"
#include "scenecalib/pipeline/calibration_pipeline.h"
#include "scenecalib/pipeline/fallback.h"
#include "scenecalib/ros/bag_recording.h"
#include "scenecalib/ros/log_sink.h"
#include "scenecalib/ros/recording_reader.h"
#include "scenecalib/ros/result_display.h"
#include "scenecalib/ros/terminal_progress.h"

namespace scenecalib {
namespace {

constexpr int kExitAccepted = 0;
constexpr int kExitNothing = 1;
constexpr int kExitPartly = 2;

struct Arguments {
  std::vector<std::string> bags;
  std::string rig;
  std::string output;
  std::string config;
  std::string truth;
  std::string trajectory;
  std::string working_directory;
  std::optional<int> threads;
  std::optional<int> seed;
  bool hold_intrinsics = false;
  bool estimate_time_offset = false;
  bool show = false;
};

void Declare(CLI::App* app, Arguments* arguments) {
  app->add_option("--bag", arguments->bags, "recording, or several: A.bag,B.bag")
      ->delimiter(',')
      ->required();
  app->add_option("--rig", arguments->rig, "rig file")->required();
  app->add_option("--output", arguments->output, "directory for the results")->required();
  app->add_option("--config", arguments->config, "YAML file with options that differ from default");
  app->add_option("--working-directory", arguments->working_directory,
                  "relative paths are taken from here (roslaunch starts programs elsewhere)");
  app->add_flag("--show", arguments->show,
                "needs a ROS master: publish the result for RViz and stay up until interrupted");
  app->add_flag("--hold-intrinsics", arguments->hold_intrinsics,
                "keep focal scale and principal point at their initial values");
  app->add_flag("--estimate-time-offset", arguments->estimate_time_offset,
                "refine each camera's time offset to the lidar clock");
  app->add_option("--threads", arguments->threads, "processor cores to use, 0 for all");
  app->add_option("--seed", arguments->seed, "seed of every random choice");
  app->add_option("--truth", arguments->truth,
                  "rig file with the truth, to compare the result with");
  app->add_option(
      "--trajectory", arguments->trajectory,
      "study tool: TUM file with the known map_from_lidar, used instead of estimating it");
}

Result<PipelineOptions> ReadOptions(const Arguments& arguments) {
  PipelineOptions options;
  if (!arguments.config.empty()) {
    SCENECALIB_RETURN_IF_ERROR(ReadOptionsYaml(arguments.config, &options));
  }
  if (arguments.threads) options.threads = *arguments.threads;
  if (arguments.seed) options.calibration.seed = *arguments.seed;
  options.calibration.hold_intrinsics |= arguments.hold_intrinsics;
  options.calibration.estimate_time_offset |= arguments.estimate_time_offset;
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  return options;
}

/// What the arguments name, read and checked before any long work begins.
struct Inputs {
  PipelineOptions options;
  Rig rig;
  BagRecording recording;
  std::optional<Trajectory> trajectory;
  std::optional<Rig> truth;
  std::optional<CalibrationResult> fallback;
};

Result<Inputs> ReadInputs(const Arguments& arguments) {
  const Result<PipelineOptions> options = ReadOptions(arguments);
  if (!options.ok()) return options.status();
  const Result<Rig> rig = ReadRig(arguments.rig);
  if (!rig.ok()) return rig.status();
  Result<BagRecording> recording = BagRecording::Open(arguments.bags);
  if (!recording.ok()) return recording.status();
  SCENECALIB_RETURN_IF_ERROR(CheckTopics(*recording, *rig));
  const Result<Rig> resolved = ResolveIntrinsics(*rig, &*recording);
  if (!resolved.ok()) return resolved.status();
  Inputs inputs{*options, *resolved, std::move(recording).value(), {}, {}, {}};
  if (!arguments.truth.empty()) {
    const Result<Rig> truth = ReadRig(arguments.truth);
    if (!truth.ok()) return truth.status();
    inputs.truth = *truth;
  }
  if (rig->fallback_file) {
    const Result<CalibrationResult> fallback = ReadCalibration(*rig->fallback_file);
    if (!fallback.ok()) return fallback.status();
    inputs.fallback = *fallback;
  }
  if (!arguments.trajectory.empty()) {
    const Result<Trajectory> trajectory = ReadTrajectoryTum(arguments.trajectory);
    if (!trajectory.ok()) return trajectory.status();
    inputs.trajectory = *trajectory;
  }
  return Result<Inputs>(std::move(inputs));
}

/// The part of the recording to read, and what a person should know about the choice.
ReceiptWindow ChooseWindow(Inputs* inputs, std::vector<std::string>* notes) {
  constexpr double kMargin_s = 0.5;  // of what is received a little late
  const std::vector<DriveSegment> stretches =
      ChooseStretches(inputs->rig, inputs->options.segment, &inputs->recording);
  if (stretches.empty()) return ReceiptWindow();
  const Timestamp begin_ns = inputs->recording.begin_ns();
  for (std::size_t i = 0; i < stretches.size(); ++i) {
    DriveSegment relative = stretches[i];
    relative.start_ns -= begin_ns;
    relative.end_ns -= begin_ns;
    notes->push_back((i == 0 ? "long recording, calibrated on its stretch with most excitation: "
                             : "a stretch that is worth it too: ") +
                     relative.Description());
  }
  return {AddSeconds(stretches[0].start_ns, -kMargin_s),
          AddSeconds(stretches[0].end_ns, kMargin_s)};
}

Result<PipelineResult> Calibrate(Inputs* inputs, const ProgressCallback& progress) {
  Result<CalibrationPipeline> pipeline = CalibrationPipeline::Create(inputs->rig, inputs->options);
  if (!pipeline.ok()) return pipeline.status();
  std::vector<std::string> notes;
  const ReceiptWindow window = ChooseWindow(inputs, &notes);
  const Result<ReadingReport> reading = FeedPipeline(
      inputs->rig, inputs->options.threads, &inputs->recording, &*pipeline, progress, window);
  if (!reading.ok()) return reading.status();
  Result<PipelineResult> result = pipeline->Run(progress, inputs->trajectory);
  if (!result.ok()) {
    std::string message = result.status().message();
    for (const std::string& warning : reading->warnings) message += "; " + warning;
    if (inputs->fallback) {
      message += "; " + *inputs->rig.fallback_file + " stays in force";
    }
    return Status(result.status().code(), message);
  }
  result->warnings.insert(result->warnings.begin(), reading->warnings.begin(),
                          reading->warnings.end());
  result->warnings.insert(result->warnings.begin(), notes.begin(), notes.end());
  if (inputs->fallback) {
    ApplyFallback(*inputs->fallback, *inputs->rig.fallback_file, &result->calibration.result);
  }
  return result;
}

int Fail(const Status& status) {
  std::fprintf(stderr, "calibrate_bag: %s\n", status.message().c_str());
  return kExitNothing;
}

int Run(const Arguments& arguments) {
  if (!arguments.working_directory.empty()) {
    std::error_code error;
    std::filesystem::current_path(arguments.working_directory, error);
    if (error) return Fail(Status::NotFound(arguments.working_directory + ": " + error.message()));
  }
  Result<Inputs> inputs = ReadInputs(arguments);
  if (!inputs.ok()) return Fail(inputs.status());
  for (const OptionDescription& option : DescribeOptions(inputs->options)) {
    std::printf("option %s: %s\n", option.key.c_str(), option.value.c_str());
  }
  TerminalProgress terminal;
  const Result<PipelineResult> result =
      Calibrate(&*inputs, [&terminal](const Progress& progress) { return terminal(progress); });
  if (!result.ok()) return Fail(result.status());
  const CalibrationResult& calibrated = result->calibration.result;
  std::string report = FormatReport(*result) + "\n" + FormatResultTable(inputs->rig, calibrated);
  if (inputs->truth) {
    report += "\n" + FormatTruthTable(*inputs->truth, inputs->rig, calibrated.rig);
  }
  const StageTimer timer("output");
  const Status written = WriteArtifacts(arguments.output, *result, report);
  if (!written.ok()) return Fail(written);
  std::printf("\n%s", report.c_str());
  std::printf("output %.1f s, ", timer.Stop().wall_s);
  std::printf("written to %s\n", arguments.output.c_str());
  const int exit_status = calibrated.accepted ? kExitAccepted : kExitPartly;
  if (arguments.show) ShowResult(*result);
  return exit_status;
}

}  // namespace

int RunCalibrateBag(int argc, char** argv) {
  std::vector<std::string> own_arguments;  // without roslaunch's __name:= and __log:=
  ros::removeROSArgs(argc, argv, own_arguments);
  std::vector<std::string> reversed(own_arguments.rbegin(), own_arguments.rend() - 1);
  InstallTerminalLogSink();
  CLI::App app("Calibrates the cameras of a rig against its lidar from a recorded drive.");
  Arguments arguments;
  Declare(&app, &arguments);
  try {
    app.parse(reversed);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kExitAccepted : kExitNothing;
  }
  try {
    return Run(arguments);
  } catch (const std::exception& error) {  // memory, file system: nothing of ours throws
    return Fail(Status::Unavailable(error.what()));
  }
}

}  // namespace scenecalib
