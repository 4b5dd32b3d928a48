#include <CLI/CLI.hpp>
#include <cstdio>

#include "scenecalib/evaluation/calibration_comparison.h"
#include "scenecalib/io/rig_yaml.h"
#include "scenecalib/ros/prepared_recording.h"
#include "scenecalib/ros/study_tools.h"

namespace scenecalib {
namespace {

constexpr int kExitMoved = 2;

Result<int> Compare(const std::vector<std::string>& files, const ComparisonLimits& limits) {
  std::vector<CalibrationResult> results;
  for (const std::string& file : files) {
    const Result<CalibrationResult> result = ReadCalibration(file);
    if (!result.ok()) return result.status();
    results.push_back(*result);
  }
  bool moved = false;
  for (std::size_t i = 1; i < results.size(); ++i) {
    const auto changes = CompareCalibrations(results[0], results[i], limits);
    for (const CameraChange& change : changes) moved |= change.moved;
    std::printf("%s -> %s\n%s\n", files[0].c_str(), files[i].c_str(),
                FormatChanges(changes).c_str());
  }
  return moved ? kExitMoved : 0;
}

}  // namespace

int RunCompare(int argc, char** argv) {
  CLI::App app(
      "Which camera moved between calibrations of one vehicle, on which axis and by how "
      "many sigma; the first file against each of the others.");
  std::vector<std::string> files;
  std::string working_directory;
  ComparisonLimits limits;
  app.add_option("files", files, "calibration files")->required()->expected(2, 1000);
  app.add_option("--sigmas", limits.sigmas, "a larger change is a motion");
  app.add_option("--stddev-factor", limits.stddev_factor,
                 "by which the stated standard deviations are widened");
  DeclareWorkingDirectory(&app, &working_directory);
  return RunTool("compare", argc, argv, &app, [&]() -> Result<int> {
    SCENECALIB_RETURN_IF_ERROR(EnterWorkingDirectory(working_directory));
    return Compare(files, limits);
  });
}

}  // namespace scenecalib
