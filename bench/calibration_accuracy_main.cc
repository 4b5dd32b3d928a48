// Accuracy of the whole calibration against the simulator's exact truth, per drive and camera, with
// the errors of the cross-camera matches.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bench/lidar_arguments.h"
#include "bench/quantile.h"
#include "bench/simulated_drive.h"
#include "scenecalib/base/log.h"
#include "scenecalib/evaluation/rig_comparison.h"
#include "scenecalib/evaluation/trajectory_error.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/io/options_yaml.h"
#include "scenecalib/pipeline/calibration_pipeline.h"

namespace scenecalib {
namespace {

constexpr double kDegrees = 180.0 / M_PI;

struct Arguments {
  std::vector<std::string> worlds = {"street",     "suburb", "plaza",
                                     "industrial", "avenue", "village"};
  std::vector<int> seeds = {1};
  DriveSpec drive;
  std::string config;
  std::vector<std::string> variants;
  bool true_trajectory = false;
  bool true_intrinsics = false;
  bool alone = false;
  double time_offset_ms = 0.0;
  bool silent_shutters = false;
  bool hold_time_offset = false;
};

/// The error of the initial time offset: the same for all cameras but of changing sign.
double TimeOffsetError_s(std::size_t camera, const Arguments& arguments) {
  return (camera % 2 == 0 ? 1e-3 : -1e-3) * arguments.time_offset_ms;
}

/// Matches between cameras against the true scene point of the source pixel, seen by the target.
void ReportMatches(const SimulatedDrive& drive, const std::vector<MatchedPixels>& matches) {
  const Simulator& truth = drive.simulator();
  std::vector<double> errors_px;
  int num_wrong = 0;
  for (const MatchedPixels& match : matches) {
    const CameraConfig& source = drive.rig().cameras[static_cast<std::size_t>(match.source_camera)];
    const CameraConfig& target = drive.rig().cameras[static_cast<std::size_t>(match.target_camera)];
    const auto point = truth.TrueScenePoint(match.source_camera,
                                            AddSeconds(match.source_stamp_ns, source.time_offset_s),
                                            match.source_px);
    std::optional<Eigen::Vector2d> seen;
    if (point && !point->is_moving) {
      seen = truth.TruePixel(match.target_camera,
                             AddSeconds(match.target_stamp_ns, target.time_offset_s),
                             point->point_in_map_m);
    }
    const double error_px = seen ? (*seen - match.target_px).norm() : 1e3;
    errors_px.push_back(error_px);
    if (error_px > 3.0) ++num_wrong;
  }
  std::printf(
      "  matches between cameras %zu: median %.3f px, 95 %% %.3f px, off by over 3 px %.2f %%\n",
      errors_px.size(), Quantile(errors_px, 0.5), Quantile(errors_px, 0.95),
      100.0 * num_wrong / std::max<std::size_t>(1, errors_px.size()));
}

Result<PipelineResult> Calibrate(const SimulatedDrive& drive, const Rig& initial,
                                 const PipelineOptions& options, bool true_trajectory) {
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
  std::optional<Trajectory> known;
  if (true_trajectory) known = drive.simulator().true_map_from_lidar();
  return pipeline->Run({}, known);
}

/// Errors of the transforms between all pairs of cameras, true camera from estimated camera.
void ReportPairs(const char* name, const Rig& truth, const Rig& estimate) {
  const auto between = [](const Rig& rig, std::size_t i, std::size_t j) {
    return rig.cameras[i].lidar_from_camera.Inverse() * rig.cameras[j].lidar_from_camera;
  };
  std::vector<double> errors_deg, errors_mm;
  for (std::size_t i = 0; i < truth.cameras.size(); ++i) {
    for (std::size_t j = i + 1; j < truth.cameras.size(); ++j) {
      const Rigid3 error = between(truth, i, j).Inverse() * between(estimate, i, j);
      errors_deg.push_back(kDegrees * LogSo3(error.rotation).norm());
      errors_mm.push_back(1e3 * error.translation.norm());
    }
  }
  if (errors_deg.empty()) return;
  std::printf("  between cameras, %s: median %.4f deg %.2f mm, worst %.4f deg %.2f mm\n", name,
              Quantile(errors_deg, 0.5), Quantile(errors_mm, 0.5),
              *std::max_element(errors_deg.begin(), errors_deg.end()),
              *std::max_element(errors_mm.begin(), errors_mm.end()));
}

/// Calibrates each camera as if it were the only one.
Result<Rig> CalibrateAlone(const PipelineResult& result, const CalibrationOptions& options) {
  Rig alone = result.initial_rig;
  for (std::size_t c = 0; c < alone.cameras.size(); ++c) {
    Rig one = result.initial_rig;
    one.cameras = {result.initial_rig.cameras[c]};
    const auto calibration =
        CalibrateRig(one, result.mapping.map, {result.segments[c]}, options, {});
    if (!calibration.ok()) return calibration.status();
    alone.cameras[c] = calibration->result.rig.cameras[0];
  }
  return alone;
}

Status Report(const SimulatedDrive& drive, const Arguments& arguments,
              const PipelineResult& result) {
  const auto errors = CompareRigs(drive.rig(), result.calibration.result.rig);
  if (!errors.ok()) return errors.status();
  for (std::size_t c = 0; c < errors->size(); ++c) {
    const CameraError& error = (*errors)[c];
    const CameraQuality& quality = result.calibration.result.cameras[c];
    std::printf(
        "  %-8s %s %.4f deg  %5.2f mm  %.3f px  f %+.5f  pp %+.2f %+.2f  inliers %d cross %d\n",
        error.name.c_str(), quality.accepted ? "accepted" : "REFUSED ",
        kDegrees * error.rotation_rad.norm(), 1e3 * error.translation_m.norm(),
        error.reprojection_rms_px, error.focal_scale, error.principal_point_px.x(),
        error.principal_point_px.y(), quality.num_inlier_tracks, quality.num_cross_camera_matches);
    const Eigen::Array3d rotation =
        error.rotation_rad.array() / quality.stddev.rotation_rad.array();
    const Eigen::Array3d translation =
        error.translation_m.array() / quality.stddev.translation_m.array();
    std::printf("           error / stddev: %+.1f %+.1f %+.1f  %+.1f %+.1f %+.1f\n", rotation[0],
                rotation[1], rotation[2], translation[0], translation[1], translation[2]);
    if (arguments.time_offset_ms != 0.0) {
      const double error_s = result.calibration.result.rig.cameras[c].time_offset_s -
                             drive.rig().cameras[c].time_offset_s;
      std::printf("           time offset %+.1f ms -> %+.3f ms (stddev %.3f)\n",
                  1e3 * TimeOffsetError_s(c, arguments), 1e3 * error_s,
                  1e3 * quality.stddev.time_offset_s);
    }
    for (const std::string& reason : quality.reasons)
      std::printf("           %s\n", reason.c_str());
  }
  ReportMatches(drive, result.calibration.evidence.matches);
  ReportPairs("together", drive.rig(), result.calibration.result.rig);
  std::printf("  ");
  for (const StageCost& cost : result.costs) {
    std::printf("%s %.1f s; ", cost.stage.c_str(), cost.wall_s);
  }
  std::printf("\n");
  std::fflush(stdout);
  return Status::Ok();
}

/// The same map and tracks calibrated again with the options of each variant.
Status ReportVariants(const SimulatedDrive& drive, const Arguments& arguments,
                      const PipelineOptions& options, const PipelineResult& result) {
  for (const std::string& variant : arguments.variants) {
    PipelineOptions changed = options;
    SCENECALIB_RETURN_IF_ERROR(ReadOptionsYaml(variant, &changed));
    changed.miscalibration.num_times = 0;
    Result<RigCalibration> calibration =
        CalibrateSegments(result.initial_rig, result.mapping.map, result.segments, result.refusals,
                          changed.calibration, changed.miscalibration, {});
    if (!calibration.ok()) return calibration.status();
    PipelineResult other;
    other.calibration = std::move(calibration).value();
    std::printf("variant %s\n", variant.c_str());
    SCENECALIB_RETURN_IF_ERROR(Report(drive, arguments, other));
  }
  return Status::Ok();
}

Status Run(const DriveSpec& spec, const Arguments& arguments) {
  PipelineOptions options;
  if (!arguments.config.empty()) {
    SCENECALIB_RETURN_IF_ERROR(ReadOptionsYaml(arguments.config, &options));
  }
  const Result<SimulatedDrive> drive = SimulatedDrive::Create(spec);
  if (!drive.ok()) return drive.status();
  Result<Rig> initial = drive->simulator().PerturbedRig();
  if (!initial.ok()) return initial.status();
  if (arguments.true_intrinsics) {
    options.calibration.hold_intrinsics = true;
    for (std::size_t c = 0; c < initial->cameras.size(); ++c) {
      initial->cameras[c].model = drive->rig().cameras[c].model;
    }
  }
  if (arguments.silent_shutters) {
    for (CameraConfig& camera : initial->cameras) camera.rolling_shutter_line_time_s.reset();
  }
  if (arguments.time_offset_ms != 0.0) {
    options.calibration.estimate_time_offset = !arguments.hold_time_offset;
    for (std::size_t c = 0; c < initial->cameras.size(); ++c) {
      initial->cameras[c].time_offset_s += TimeOffsetError_s(c, arguments);
    }
  }
  const Result<PipelineResult> result =
      Calibrate(*drive, *initial, options, arguments.true_trajectory);
  if (!result.ok()) return result.status();
  std::printf("%s%s%s\n", Describe(spec).c_str(),
              arguments.true_trajectory ? ", true trajectory" : "",
              arguments.true_intrinsics ? ", true intrinsics held" : "");
  SCENECALIB_RETURN_IF_ERROR(Report(*drive, arguments, *result));
  SCENECALIB_RETURN_IF_ERROR(ReportVariants(*drive, arguments, options, *result));
  if (!arguments.alone) return Status::Ok();
  const Result<Rig> alone = CalibrateAlone(*result, options.calibration);
  if (!alone.ok()) return alone.status();
  ReportPairs("each alone", drive->rig(), *alone);
  return Status::Ok();
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("Accuracy of the calibration on simulated drives.");
  scenecalib::Arguments arguments;
  app.add_option("--world", arguments.worlds, scenecalib::KnownWorldKinds());
  app.add_option("--seed", arguments.seeds, "of the worlds and drives");
  app.add_option("--rig", arguments.drive.rig, "rig file (default: the built-in rig)");
  app.add_option("--drive", arguments.drive.drive, "turns, gentle or straight");
  app.add_option("--duration", arguments.drive.duration_s, "seconds");
  app.add_option("--speed", arguments.drive.speed_m_s, "m/s");
  scenecalib::AddLidarArguments(&app, &arguments.drive.lidar);
  app.add_option("--moving-cars", arguments.drive.num_moving_cars, "other cars that drive");
  app.add_option("--start-deg", arguments.drive.start.rotation_deg, "initial error per axis");
  app.add_option("--start-m", arguments.drive.start.translation_m, "initial error per axis");
  app.add_option("--config", arguments.config, "options of the pipeline, YAML");
  app.add_option("--variant", arguments.variants,
                 "also calibrate the same map and tracks with the calibration's options of this "
                 "file; repeatable");
  app.add_option("--cache", arguments.drive.cache_directory, "directory to keep the drives in");
  app.add_flag("--true-trajectory", arguments.true_trajectory, "instead of the estimated one");
  app.add_flag("--true-intrinsics", arguments.true_intrinsics, "given and held");
  app.add_flag("--alone", arguments.alone, "also calibrate every camera alone, for comparison");
  app.add_option("--time-offset-ms", arguments.time_offset_ms,
                 "the initial time offsets are off by so much, plus and minus in turn; estimated");
  app.add_flag("--hold-time-offset", arguments.hold_time_offset, "and held, instead of estimated");
  app.add_flag("--silent-shutters", arguments.silent_shutters,
               "the initial rig says nothing of the rig's rolling shutters");
  CLI11_PARSE(app, argc, argv);
  scenecalib::SetLogSink([](scenecalib::LogSeverity, const std::string& message) {
    std::fprintf(stderr, "%s\n", message.c_str());
  });
  for (const std::string& world : arguments.worlds) {
    for (const int seed : arguments.seeds) {
      arguments.drive.world = world;
      arguments.drive.seed = seed;
      const scenecalib::Status status = scenecalib::Run(arguments.drive, arguments);
      if (!status.ok()) {
        std::fprintf(stderr, "%s\n", status.message().c_str());
        return 1;
      }
    }
  }
  return 0;
}
