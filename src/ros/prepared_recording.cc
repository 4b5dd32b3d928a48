#include "scenecalib/ros/prepared_recording.h"

#include <ros/init.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <system_error>
#include <utility>

#include "scenecalib/io/options_yaml.h"
#include "scenecalib/io/rig_yaml.h"
#include "scenecalib/ros/bag_recording.h"
#include "scenecalib/ros/log_sink.h"
#include "scenecalib/ros/recording_reader.h"

namespace scenecalib {
namespace {

Status CheckSameCameras(const Rig& first, const Rig& other, const std::string& name) {
  if (first.cameras.size() != other.cameras.size()) {
    return Status::InvalidArgument(name + ": has other cameras than the first rig file");
  }
  for (std::size_t i = 0; i < first.cameras.size(); ++i) {
    const CameraConfig& a = first.cameras[i];
    const CameraConfig& b = other.cameras[i];
    if (a.name != b.name || a.model->width_px() != b.model->width_px() ||
        a.model->height_px() != b.model->height_px()) {
      return Status::InvalidArgument(name + ": camera " + b.name +
                                     " is not the first rig file's camera " + a.name +
                                     " by name, order and image size");
    }
  }
  return Status::Ok();
}

}  // namespace

void DeclareRecordingArguments(CLI::App* app, RecordingArguments* arguments) {
  app->add_option("--bag", arguments->bags, "recording, or several: A.bag,B.bag")
      ->delimiter(',')
      ->required();
  app->add_option("--rig", arguments->rigs, "rig or calibration file, or several: A.yaml,B.yaml")
      ->delimiter(',')
      ->required();
  app->add_option("--output", arguments->output, "directory for the results");
  app->add_option("--config", arguments->config, "YAML file with options that differ from default");
  app->add_option("--threads", arguments->threads, "processor cores to use, 0 for all");
  DeclareWorkingDirectory(app, &arguments->working_directory);
}

void DeclareWorkingDirectory(CLI::App* app, std::string* directory) {
  app->add_option("--working-directory", *directory,
                  "relative paths are taken from here (roslaunch starts programs elsewhere)");
}

Status EnterWorkingDirectory(const std::string& directory) {
  if (directory.empty()) return Status::Ok();
  std::error_code error;
  std::filesystem::current_path(directory, error);
  return error ? Status::NotFound(directory + ": " + error.message()) : Status::Ok();
}

Result<PreparedRecording> PrepareRecording(const RecordingArguments& arguments,
                                           const ProgressCallback& progress) {
  SCENECALIB_RETURN_IF_ERROR(EnterWorkingDirectory(arguments.working_directory));
  PreparedRecording recording;
  if (!arguments.config.empty()) {
    SCENECALIB_RETURN_IF_ERROR(ReadOptionsYaml(arguments.config, &recording.options));
  }
  if (arguments.threads) recording.options.threads = *arguments.threads;
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(recording.options));
  Result<BagRecording> bags = BagRecording::Open(arguments.bags);
  if (!bags.ok()) return bags.status();
  for (const std::string& path : arguments.rigs) {
    const Result<Rig> rig = ReadRig(path);
    if (!rig.ok()) return rig.status();
    SCENECALIB_RETURN_IF_ERROR(CheckTopics(*bags, *rig));
    const Result<Rig> resolved = ResolveIntrinsics(*rig, &*bags);
    if (!resolved.ok()) return resolved.status();
    recording.rigs.push_back(*resolved);
    SCENECALIB_RETURN_IF_ERROR(CheckSameCameras(recording.rigs.front(), *resolved, path));
  }
  const Rig& rig = recording.rigs.front();
  Result<CalibrationPipeline> pipeline = CalibrationPipeline::Create(rig, recording.options);
  if (!pipeline.ok()) return pipeline.status();
  const Result<ReadingReport> reading =
      FeedPipeline(rig, recording.options.threads, &*bags, &*pipeline, progress);
  if (!reading.ok()) return reading.status();
  Result<PipelineResult> prepared = pipeline->Prepare(progress);
  if (!prepared.ok()) return prepared.status();
  recording.prepared = std::move(prepared).value();
  return Result<PreparedRecording>(std::move(recording));
}

int RunTool(const std::string& name, int argc, char** argv, CLI::App* app,
            const std::function<Result<int>()>& body) {
  std::vector<std::string> own_arguments;  // without roslaunch's __name:= and __log:=
  ros::removeROSArgs(argc, argv, own_arguments);
  std::vector<std::string> reversed(own_arguments.rbegin(), own_arguments.rend() - 1);
  InstallTerminalLogSink();
  const auto fail = [&name](const std::string& message) {
    std::fprintf(stderr, "%s: %s\n", name.c_str(), message.c_str());
    return 1;
  };
  try {
    app->parse(reversed);
  } catch (const CLI::ParseError& error) {
    return app->exit(error) == 0 ? 0 : 1;
  }
  try {
    const Result<int> status = body();
    return status.ok() ? *status : fail(status.status().message());
  } catch (const std::exception& error) {  // memory, file system: nothing of ours throws
    return fail(error.what());
  }
}

}  // namespace scenecalib
