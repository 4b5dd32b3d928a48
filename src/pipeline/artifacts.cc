#include "scenecalib/pipeline/artifacts.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <system_error>
#include <vector>

#include "scenecalib/io/rig_yaml.h"
#include "scenecalib/io/trajectory_tum.h"
#include "scenecalib/mapping/ply.h"
#include "scenecalib/pipeline/overlays.h"
#include "scenecalib/pipeline/report.h"

namespace scenecalib {
namespace {

namespace fs = std::filesystem;

constexpr int kImagesPerOverlay = 4;

template <typename... Args>
std::string Format(const char* format, Args... args) {
  char text[512];
  std::snprintf(text, sizeof(text), format, args...);
  return text;
}

Status WriteText(const fs::path& path, const std::string& text) {
  std::ofstream file(path);
  file << text;
  file.close();
  return file ? Status::Ok() : Status::Unavailable("cannot write " + path.string());
}

Status FirstError(const std::vector<Status>& statuses) {
  const auto error = std::find_if(statuses.begin(), statuses.end(),
                                  [](const Status& status) { return !status.ok(); });
  return error == statuses.end() ? Status::Ok() : *error;
}

Status WriteOverlays(const fs::path& directory, const std::vector<CameraOverlays>& overlays) {
  std::error_code error;
  fs::create_directories(directory, error);
  std::vector<Status> statuses(2 * overlays.size());
  tbb::parallel_for(std::size_t{0}, statuses.size(), [&](std::size_t i) {
    const CameraOverlays& camera = overlays[i / 2];
    const bool is_after = i % 2 == 1;
    const fs::path path = directory / (camera.camera + (is_after ? "_after.png" : "_before.png"));
    // Without a level OpenCV is fastest, and no larger.
    if (!cv::imwrite(path.string(), is_after ? camera.after : camera.before)) {
      statuses[i] = Status::Unavailable("cannot write " + path.string());
    }
  });
  return FirstError(statuses);
}

Status WriteMap(const fs::path& directory, const SceneMap& map) {
  SCENECALIB_RETURN_IF_ERROR(
      WritePly((directory / "ground.ply").string(), map.ground, PlyFormat::kBinary));
  return WritePly((directory / "surfels.ply").string(), map.surfels, PlyFormat::kBinary);
}

Status WriteReport(const fs::path& directory, const PipelineResult& result,
                   const std::vector<CameraOverlays>& overlays) {
  const Result<ReportData> data = MakeReportData(result, overlays);
  if (!data.ok()) return data.status();
  std::error_code error;
  fs::create_directories(directory, error);
  return WriteText(directory / "index.html", FormatReportPage(*data));
}

Status WriteAll(const fs::path& directory, const PipelineResult& result,
                const std::string& report) {
  const SceneMap& map = result.mapping.map;
  const Result<std::vector<CameraOverlays>> overlays = DrawOverlays(
      result.initial_rig, result.calibration.result.rig, map, result.segments, kImagesPerOverlay);
  if (!overlays.ok()) return overlays.status();
  std::vector<Status> statuses(4);
  tbb::parallel_invoke(
      [&] {
        statuses[0] =
            WriteTrajectoryTum((directory / "trajectory.tum").string(), map.map_from_lidar);
        if (statuses[0].ok()) statuses[0] = WriteText(directory / "report.txt", report);
      },
      [&] { statuses[1] = WriteMap(directory, map); },
      [&] { statuses[2] = WriteOverlays(directory / "overlays", *overlays); },
      [&] { statuses[3] = WriteReport(directory / "report", result, *overlays); });
  SCENECALIB_RETURN_IF_ERROR(FirstError(statuses));
  return WriteCalibration((directory / "calibration.yaml").string(), result.calibration.result);
}

/// Moves every entry of `from` over the one of the same name in `to`; calibration.yaml last.
std::error_code MoveInto(const fs::path& from, const fs::path& to) {
  std::vector<fs::path> names;
  for (const fs::directory_entry& entry : fs::directory_iterator(from)) {
    if (entry.path().filename() != "calibration.yaml") names.push_back(entry.path().filename());
  }
  names.emplace_back("calibration.yaml");
  std::error_code error;
  for (const fs::path& name : names) {
    if (fs::is_directory(to / name, error)) fs::remove_all(to / name, error);
    fs::rename(from / name, to / name, error);
    if (error) return error;
  }
  return error;
}

}  // namespace

std::string FormatReport(const PipelineResult& result) {
  const MappingReport& mapping = result.mapping.report;
  std::string text = "stage                        wall s  peak MiB\n";
  for (const StageCost& cost : result.costs) {
    text += Format("%-28s %6.1f  %8.0f\n", cost.stage.c_str(), cost.wall_s, cost.peak_memory_mib);
  }
  text +=
      Format("lidar: %d of %d scans used, %.1f m travelled, IMU %s, odometry %s\n",
             mapping.num_scans_used, mapping.num_scans_in, mapping.path_length_m,
             mapping.used_imu ? "used" : "not used", mapping.used_odometry ? "used" : "not used");
  text += DescribeLasers(mapping) + "\n";
  text += Format("map: %zu surfels, %zu ground triangles, %d points of moving objects removed\n",
                 result.mapping.map.surfels.size(), result.mapping.map.ground.triangles.size(),
                 mapping.num_points_moving);
  for (std::size_t i = 0; i < result.segments.size(); ++i) {
    const CameraSegment& segment = result.segments[i];
    text += Format("camera %s: %d images, %zu tracks\n", result.initial_rig.cameras[i].name.c_str(),
                   segment.num_images_in, segment.tracks.size());
    for (const std::string& warning : segment.warnings) text += "warning: " + warning + "\n";
  }
  for (const std::string& warning : mapping.warnings) text += "warning: " + warning + "\n";
  for (const std::string& warning : result.warnings) text += "warning: " + warning + "\n";
  return text;
}

Status WriteArtifacts(const std::string& directory, const PipelineResult& result,
                      const std::string& report) {
  const fs::path target = directory;
  const fs::path partial = target / ".partial";
  std::error_code error;
  fs::remove_all(partial, error);
  fs::create_directories(partial, error);
  if (error) {
    return Status::Unavailable("cannot make " + partial.string() + ": " + error.message());
  }
  const Status status = WriteAll(partial, result, report);
  if (status.ok()) error = MoveInto(partial, target);
  std::error_code ignored;
  fs::remove_all(partial, ignored);
  SCENECALIB_RETURN_IF_ERROR(status);
  if (error) return Status::Unavailable("cannot write into " + directory + ": " + error.message());
  return Status::Ok();
}

}  // namespace scenecalib
