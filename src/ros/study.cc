#include "scenecalib/pipeline/study.h"

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <system_error>

#include "scenecalib/io/atomic_file.h"
#include "scenecalib/ros/prepared_recording.h"
#include "scenecalib/ros/study_tools.h"
#include "scenecalib/ros/terminal_progress.h"

namespace scenecalib {
namespace {

Status Write(const std::string& directory, const std::vector<StudyCamera>& cameras) {
  std::error_code error;
  std::filesystem::create_directories(directory, error);
  SCENECALIB_RETURN_IF_ERROR(
      WriteFileAtomically(directory + "/study.csv", FormatStudyCsv(cameras)));
  return WriteFileAtomically(directory + "/study.html", FormatStudyPage(cameras));
}

Result<int> Study(const RecordingArguments& arguments, const StudyOptions& options) {
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  TerminalProgress terminal;
  const ProgressCallback progress = [&terminal](const Progress& p) { return terminal(p); };
  const Result<PreparedRecording> recording = PrepareRecording(arguments, progress);
  if (!recording.ok()) return recording.status();
  // Written after every start: a study takes long, and one that is stopped has said something.
  const auto write = [&arguments](const std::vector<StudyCamera>& cameras) {
    return arguments.output.empty() ? Status::Ok() : Write(arguments.output, cameras);
  };
  const auto cameras = RunStudy(recording->rigs.front(), recording->prepared,
                                recording->options.calibration, options, progress, write);
  if (!cameras.ok()) return cameras.status();
  std::printf("\n%s", FormatStudy(*cameras).c_str());
  if (!arguments.output.empty()) std::printf("written to %s\n", arguments.output.c_str());
  return 0;
}

}  // namespace

int RunStudy(int argc, char** argv) {
  CLI::App app("Repeatability and range: calibrates one recording from many starts.");
  RecordingArguments arguments;
  StudyOptions options;
  DeclareRecordingArguments(&app, &arguments);
  app.add_option("--starts", options.starts, "calibrations");
  app.add_option("--max-deg", options.max_deg, "largest initial error per rotation axis");
  app.add_option("--max-m", options.max_m, "largest initial error per translation axis");
  app.add_option("--seed", options.seed, "of the starts");
  return RunTool("study", argc, argv, &app, [&] { return Study(arguments, options); });
}

}  // namespace scenecalib
