#include "scenecalib/ros/calibrate_bag.h"

#include <ros/init.h>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <optional>
#include <string>
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
#include "scenecalib/pipeline/stretch_combination.h"
#include "scenecalib/ros/bag_recording.h"
#include "scenecalib/ros/log_sink.h"
#include "scenecalib/ros/prepared_recording.h"
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
  DeclareWorkingDirectory(app, &arguments->working_directory);
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
  std::vector<EarlierCalibration> earlier;  ///< the rig file's fallback
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
  const auto fallback = ReadFallback(*rig);
  if (!fallback.ok()) return fallback.status();
  if (*fallback) inputs.earlier.push_back(**fallback);
  if (!arguments.trajectory.empty()) {
    const Result<Trajectory> trajectory = ReadTrajectoryTum(arguments.trajectory);
    if (!trajectory.ok()) return trajectory.status();
    inputs.trajectory = *trajectory;
  }
  return Result<Inputs>(std::move(inputs));
}

/// Maps, tracks and calibrates what lies in the window.
Result<PipelineResult> CalibrateWindow(Inputs* inputs, const ReceiptWindow& window,
                                       const ProgressCallback& progress) {
  Result<CalibrationPipeline> pipeline = CalibrationPipeline::Create(inputs->rig, inputs->options);
  if (!pipeline.ok()) return pipeline.status();
  const Result<ReadingReport> reading = FeedPipeline(
      inputs->rig, inputs->options.threads, &inputs->recording, &*pipeline, progress, window);
  if (!reading.ok()) return reading.status();
  Result<PipelineResult> result = pipeline->Run(progress, inputs->trajectory);
  if (!result.ok()) {
    std::string message = result.status().message();
    for (const std::string& warning : reading->warnings) message += "; " + warning;
    return Status(result.status().code(), message);
  }
  result->warnings.insert(result->warnings.begin(), reading->warnings.begin(),
                          reading->warnings.end());
  return result;
}

/// The stretches of a long recording, the best first, calibrated one by one.
class StretchCalibrator {
 public:
  StretchCalibrator(Inputs* inputs, std::vector<DriveSegment> stretches,
                    const ProgressCallback& progress)
      : inputs_(inputs),
        stretches_(std::move(stretches)),
        calibrated_(stretches_.size()),
        progress_(progress) {}

  /// The combined calibration, with the map and images of the best stretch that gave one. No more
  /// than one stretch is in memory at a time.
  Result<PipelineResult> Run() {
    for (std::size_t k = stretches_.size(); k-- > 1;) {
      const Result<PipelineResult> result = Calibrate(k);
      if (result.status().code() == Status::Code::kCancelled) return result.status();
    }
    for (std::size_t k = 0; k < stretches_.size(); ++k) {
      if (k > 0 && !calibrated_[k]) continue;
      Result<PipelineResult> shown = Calibrate(k);  // once more where better ones failed
      if (shown.ok()) return Combine(std::move(shown).value());
      if (shown.status().code() == Status::Code::kCancelled) return shown;
    }
    std::string message = "no stretch of the recording could be calibrated";
    for (const std::string& note : notes_) message += "; " + note;
    return Status::InsufficientData(message);
  }

 private:
  std::string Name(std::size_t k) const { return "stretch " + std::to_string(k + 1); }

  Result<PipelineResult> Calibrate(std::size_t k) {
    constexpr double kMargin_s = 0.5;  // of what is received a little late
    const StageTimer timer(Name(k));
    Result<PipelineResult> result = CalibrateWindow(inputs_,
                                                    {AddSeconds(stretches_[k].start_ns, -kMargin_s),
                                                     AddSeconds(stretches_[k].end_ns, kMargin_s)},
                                                    progress_);
    if (result.ok()) {
      calibrated_[k] = StretchCalibration{Name(k), result->calibration.result};
      if (k > 0) costs_.push_back(timer.Stop());
    } else {
      notes_.push_back(Name(k) + " is left out: " + result.status().message());
    }
    return result;
  }

  Result<PipelineResult> Combine(PipelineResult shown) {
    std::vector<std::string> notes;
    const Timestamp begin_ns = inputs_->recording.begin_ns();
    for (std::size_t k = 0; k < stretches_.size(); ++k) {
      DriveSegment relative = stretches_[k];
      relative.start_ns -= begin_ns;
      relative.end_ns -= begin_ns;
      notes.push_back("long recording, " + Name(k) +
                      " of those with most excitation: " + relative.Description());
    }
    notes.insert(notes.end(), notes_.begin(), notes_.end());
    shown.warnings.insert(shown.warnings.begin(), notes.begin(), notes.end());
    shown.costs.insert(shown.costs.begin(), costs_.begin(), costs_.end());
    std::vector<StretchCalibration> calibrated;
    for (const auto& stretch : calibrated_) {
      if (stretch) calibrated.push_back(*stretch);
    }
    if (calibrated.size() < 2) return Result<PipelineResult>(std::move(shown));
    Result<CalibrationResult> combined =
        CombineStretches(inputs_->rig, inputs_->options.calibration.prior, calibrated);
    if (!combined.ok()) return combined.status();
    SCENECALIB_RETURN_IF_ERROR(AddMiscalibrationRates(inputs_->rig, shown.mapping.map,
                                                      shown.segments,
                                                      inputs_->options.miscalibration, &*combined));
    shown.calibration.result = std::move(combined).value();
    return Result<PipelineResult>(std::move(shown));
  }

  Inputs* inputs_;
  std::vector<DriveSegment> stretches_;
  std::vector<std::optional<StretchCalibration>> calibrated_;  ///< parallel to stretches_
  const ProgressCallback& progress_;
  std::vector<std::string> notes_;
  std::vector<StageCost> costs_;
};

Result<PipelineResult> Calibrate(Inputs* inputs, const ProgressCallback& progress) {
  std::vector<DriveSegment> stretches =
      ChooseStretches(inputs->rig, inputs->options.segment, &inputs->recording);
  Result<PipelineResult> result =
      stretches.empty() ? CalibrateWindow(inputs, ReceiptWindow(), progress)
                        : StretchCalibrator(inputs, std::move(stretches), progress).Run();
  if (!result.ok()) {
    return Status(result.status().code(),
                  result.status().message() + StaysInForce(inputs->earlier));
  }
  ApplyFallback(inputs->earlier, &result->calibration.result);
  return result;
}

int Fail(const Status& status) {
  std::fprintf(stderr, "calibrate_bag: %s\n", status.message().c_str());
  return kExitNothing;
}

int Run(const Arguments& arguments) {
  const Status entered = EnterWorkingDirectory(arguments.working_directory);
  if (!entered.ok()) return Fail(entered);
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

/// Images and clouds come and go by the thousand. Memory that was freed stays with the process,
/// instead of being mapped, cleared and unmapped for each: a fifth of the system's time.
void KeepFreedMemory() {
#ifdef __GLIBC__
  constexpr int kMiB = 1 << 20;
  mallopt(M_MMAP_THRESHOLD, 32 * kMiB);  // the most that glibc takes
  mallopt(M_TRIM_THRESHOLD, 512 * kMiB);
#endif
}

}  // namespace

int RunCalibrateBag(int argc, char** argv) {
  std::vector<std::string> own_arguments;  // without roslaunch's __name:= and __log:=
  ros::removeROSArgs(argc, argv, own_arguments);
  std::vector<std::string> reversed(own_arguments.rbegin(), own_arguments.rend() - 1);
  InstallTerminalLogSink();
  KeepFreedMemory();
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
