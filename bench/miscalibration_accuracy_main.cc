// Miscalibration rates (IV-A) on simulated drives: of the exact truth, of the start and of our
// result, per camera and by field of view; and what the metric makes of an error on one axis.

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "bench/simulated_drive.h"
#include "scenecalib/evaluation/rate_table.h"
#include "scenecalib/evaluation/rig_comparison.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/io/options_yaml.h"
#include "scenecalib/pipeline/calibration_pipeline.h"

namespace scenecalib {
namespace {

struct Arguments {
  std::vector<std::string> worlds = {"street",     "suburb", "plaza",
                                     "industrial", "avenue", "village"};
  std::vector<int> seeds = {1};
  DriveSpec drive;
  std::string config;
  bool perturb = false;
};

Result<PipelineResult> Run(const SimulatedDrive& drive, const Rig& initial,
                           const PipelineOptions& options) {
  Result<CalibrationPipeline> pipeline = CalibrationPipeline::Create(initial, options);
  if (!pipeline.ok()) return pipeline.status();
  for (const ImuSample& sample : drive.imu()) pipeline->AddImu(sample);
  for (const OdometrySample& sample : drive.odometry()) pipeline->AddOdometry(sample);
  for (int i = 0; i < drive.num_scans(); ++i) {
    SCENECALIB_RETURN_IF_ERROR(pipeline->AddScan(drive.Scan(i)));
  }
  for (int c = 0; c < static_cast<int>(initial.cameras.size()); ++c) {
    for (int i = 0; i < drive.simulator().num_images(c); ++i) {
      SCENECALIB_RETURN_IF_ERROR(pipeline->AddImage(c, drive.Image(c, i)));
    }
  }
  return pipeline->Run({});
}

std::vector<double> ByAxis(const MiscalibrationRate& rate) {
  return {rate.x, rate.y, rate.z, rate.pitch, rate.yaw, rate.roll};
}

using Rates = std::vector<std::optional<MiscalibrationRate>>;

Result<std::vector<Rates>> RatesOf(const std::vector<Rig>& rigs, const PipelineResult& result,
                                   const MiscalibrationOptions& options) {
  std::vector<const std::map<Timestamp, cv::Mat>*> images;
  for (const CameraSegment& segment : result.segments) images.push_back(&segment.images);
  return ComputeMiscalibrationRates(rigs, result.mapping.map, images, options);
}

/// One camera's axis off by 1 cm or 0.1 degrees: how every axis' rate changes.
Status Perturb(const Rig& truth, const Rates& of_truth, const PipelineResult& result,
               const MiscalibrationOptions& options) {
  static const char* const kAxes[] = {"x", "y", "z", "pitch", "yaw", "roll"};
  std::vector<Rig> rigs;
  for (std::size_t c = 0; c < truth.cameras.size(); ++c) {
    for (int axis = 0; axis < 6; ++axis) {
      const Eigen::Vector3d along = Eigen::Vector3d::Unit(axis % 3);
      Rig rig = truth;
      Rigid3& lidar_from_camera = rig.cameras[c].lidar_from_camera;
      lidar_from_camera =
          lidar_from_camera *
          (axis < 3 ? Rigid3(Eigen::Quaterniond::Identity(), 0.01 * along)
                    : Rigid3(ExpSo3(0.1 * M_PI / 180.0 * along), Eigen::Vector3d::Zero()));
      rigs.push_back(rig);
    }
  }
  const Result<std::vector<Rates>> rates = RatesOf(rigs, result, options);
  if (!rates.ok()) return rates.status();
  for (std::size_t i = 0; i < rigs.size(); ++i) {
    const std::size_t c = i / 6;
    const int axis = static_cast<int>(i % 6);
    if (!of_truth[c] || !(*rates)[i][c]) continue;
    std::printf("%-10s %-6s off:", truth.cameras[c].name.c_str(), kAxes[axis]);
    for (int k = 0; k < 6; ++k) {
      const double change = ByAxis(*(*rates)[i][c])[static_cast<std::size_t>(k)] -
                            ByAxis(*of_truth[c])[static_cast<std::size_t>(k)];
      std::printf(k == axis ? " [%+.3f]" : "  %+.3f ", change);
    }
    std::printf("\n");
  }
  return Status::Ok();
}

Status PrintErrors(const Rig& truth, const CalibrationResult& result) {
  const auto errors = CompareRigs(truth, result.rig);
  if (!errors.ok()) return errors.status();
  for (std::size_t c = 0; c < errors->size(); ++c) {
    const CameraError& error = (*errors)[c];
    std::printf("%-10s %s %.4f deg  %5.2f mm  %.3f px\n", error.name.c_str(),
                result.cameras[c].accepted ? "accepted" : "REFUSED ",
                180.0 / M_PI * error.rotation_rad.norm(), 1e3 * error.translation_m.norm(),
                error.reprojection_rms_px);
    for (const std::string& reason : result.cameras[c].reasons) {
      std::printf("           %s\n", reason.c_str());
    }
  }
  return Status::Ok();
}

Status Measure(const Arguments& arguments, const DriveSpec& spec) {
  PipelineOptions options;
  if (!arguments.config.empty()) {
    SCENECALIB_RETURN_IF_ERROR(ReadOptionsYaml(arguments.config, &options));
  }
  const Result<SimulatedDrive> drive = SimulatedDrive::Create(spec);
  if (!drive.ok()) return drive.status();
  const Result<Rig> initial = drive->simulator().PerturbedRig();
  if (!initial.ok()) return initial.status();
  const Result<PipelineResult> result = Run(*drive, *initial, options);
  if (!result.ok()) return result.status();
  const Result<std::vector<Rates>> of_truth =
      RatesOf({drive->rig()}, *result, options.miscalibration);
  if (!of_truth.ok()) return of_truth.status();
  Rates before;
  Rates after;
  for (const CameraQuality& quality : result->calibration.result.cameras) {
    before.push_back(quality.miscalibration_rate_before);
    after.push_back(quality.miscalibration_rate_after);
  }
  std::printf("%s\n%s", Describe(spec).c_str(),
              FormatRateTable(drive->rig().cameras,
                              {{"truth", of_truth->front()}, {"result", after}, {"start", before}})
                  .c_str());
  SCENECALIB_RETURN_IF_ERROR(PrintErrors(drive->rig(), result->calibration.result));
  std::fflush(stdout);
  return arguments.perturb
             ? Perturb(drive->rig(), of_truth->front(), *result, options.miscalibration)
             : Status::Ok();
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("Miscalibration rates on simulated drives.");
  scenecalib::Arguments arguments;
  app.add_option("--world", arguments.worlds, scenecalib::KnownWorldKinds());
  app.add_option("--seed", arguments.seeds, "of the worlds and drives");
  app.add_option("--rig", arguments.drive.rig, "rig file (default: the built-in rig)");
  app.add_option("--duration", arguments.drive.duration_s, "seconds");
  app.add_option("--cache", arguments.drive.cache_directory, "directory to keep the drives in");
  app.add_option("--config", arguments.config, "options of the pipeline, YAML");
  app.add_flag("--perturb", arguments.perturb, "put the truth's axes off one by one");
  CLI11_PARSE(app, argc, argv);
  for (const std::string& world : arguments.worlds) {
    for (const int seed : arguments.seeds) {
      scenecalib::DriveSpec spec = arguments.drive;
      spec.world = world;
      spec.seed = seed;
      const scenecalib::Status status = scenecalib::Measure(arguments, spec);
      if (!status.ok()) {
        std::fprintf(stderr, "%s\n", status.message().c_str());
        return 1;
      }
    }
  }
  return 0;
}
