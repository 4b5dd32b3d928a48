#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "scenecalib/base/progress.h"
#include "scenecalib/base/status.h"
#include "scenecalib/pipeline/calibration_pipeline.h"

namespace CLI {
class App;
}

namespace scenecalib {

/// What the programs take that judge or study calibrations on a recording.
struct RecordingArguments {
  std::vector<std::string> bags;
  std::vector<std::string> rigs;  ///< the first one names topics and initial values
  std::string output;
  std::string config;
  std::string working_directory;
  std::optional<int> threads;
};

void DeclareRecordingArguments(CLI::App* app, RecordingArguments* arguments);

/// `--working-directory`: roslaunch starts programs elsewhere than where it was called.
void DeclareWorkingDirectory(CLI::App* app, std::string* directory);
/// NotFound, naming it, when it cannot be entered; an empty one changes nothing.
Status EnterWorkingDirectory(const std::string& directory);

/// A recording mapped and tracked once.
struct PreparedRecording {
  PipelineOptions options;
  std::vector<Rig> rigs;  ///< parallel to the arguments' rigs, with intrinsics
  PipelineResult prepared;
};

/// Reads rigs and recording, maps and tracks. InvalidArgument when a rig's cameras are not those of
/// the first by name and image size.
Result<PreparedRecording> PrepareRecording(const RecordingArguments& arguments,
                                           const ProgressCallback& progress);

/// Runs a program's body after parsing the arguments, without what roslaunch adds to them; errors
/// go to stderr as one line "NAME: ...", with exit status 1.
int RunTool(const std::string& name, int argc, char** argv, CLI::App* app,
            const std::function<Result<int>()>& body);

}  // namespace scenecalib
