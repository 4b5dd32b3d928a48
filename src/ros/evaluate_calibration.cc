#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <system_error>

#include "scenecalib/evaluation/rate_table.h"
#include "scenecalib/io/atomic_file.h"
#include "scenecalib/ros/prepared_recording.h"
#include "scenecalib/ros/study_tools.h"
#include "scenecalib/ros/terminal_progress.h"

namespace scenecalib {
namespace {

Result<int> Evaluate(const RecordingArguments& arguments) {
  TerminalProgress terminal;
  const Result<PreparedRecording> recording = PrepareRecording(
      arguments, [&terminal](const Progress& progress) { return terminal(progress); });
  if (!recording.ok()) return recording.status();
  std::vector<const std::map<Timestamp, cv::Mat>*> images;
  for (const CameraSegment& segment : recording->prepared.segments) {
    images.push_back(&segment.images);
  }
  const auto rates = ComputeMiscalibrationRates(recording->rigs, recording->prepared.mapping.map,
                                                images, recording->options.miscalibration);
  if (!rates.ok()) return rates.status();
  std::vector<RatedRig> rated;
  for (std::size_t i = 0; i < recording->rigs.size(); ++i) {
    rated.push_back({arguments.rigs[i], (*rates)[i]});
  }
  const std::vector<CameraConfig>& cameras = recording->rigs.front().cameras;
  std::printf("\n%s", FormatRateTable(cameras, rated).c_str());
  if (arguments.output.empty()) return 0;
  std::error_code error;
  std::filesystem::create_directories(arguments.output, error);
  SCENECALIB_RETURN_IF_ERROR(WriteFileAtomically(arguments.output + "/miscalibration_rates.yaml",
                                                 FormatRateYaml(cameras, rated)));
  std::printf("written to %s\n", arguments.output.c_str());
  return 0;
}

}  // namespace

int RunEvaluateCalibration(int argc, char** argv) {
  CLI::App app("Miscalibration rates (0 is ideal, 0.5 is well off) of rig files on a recording.");
  RecordingArguments arguments;
  DeclareRecordingArguments(&app, &arguments);
  return RunTool("evaluate_calibration", argc, argv, &app,
                 [&arguments] { return Evaluate(arguments); });
}

}  // namespace scenecalib
