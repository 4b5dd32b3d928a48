#pragma once

#include <Eigen/Core>
#include <functional>
#include <string>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/pipeline/calibration_pipeline.h"

namespace scenecalib {

struct StudyOptions {
  int starts = 50;
  double max_deg = 2.0;
  double max_m = 0.2;
  double success_deg = 0.1;
  double success_m = 0.03;
  int seed = 1;
  void Visit(OptionVisitor& v) {
    v.Field("starts", &starts, {2, 100000}, "calibrations");
    v.Field("max_deg", &max_deg, {0.0, 45.0}, "largest initial error per rotation axis");
    v.Field("max_m", &max_m, {0.0, 5.0}, "largest initial error per translation axis");
    v.Field("success_deg", &success_deg, {1e-4, 45.0},
            "a start succeeds when it ends this near the middle of all accepted ones");
    v.Field("success_m", &success_m, {1e-5, 5.0}, "the same of the position");
    v.Field("seed", &seed, {0, 2147483647}, "of the starts");
  }
};

/// Where one start took one camera.
struct StudyCameraOutcome {
  double start_deg = 0.0;  ///< initial error: length of the rotation vector
  double start_m = 0.0;
  bool accepted = false;
  Rigid3 lidar_from_camera;
  double end_deg = 0.0;  ///< distance from the middle of all accepted results
  double end_m = 0.0;
  bool success = false;
};

struct StudyCamera {
  std::string name;
  std::vector<StudyCameraOutcome> outcomes;  ///< one per start, from the smallest error on
  int num_success = 0;
  int num_accepted_elsewhere = 0;  ///< believed although they did not end where the others did
  /// RMS of the successful starts' deviations, per axis of the camera (right, down, forward).
  Eigen::Vector3d spread_rad = Eigen::Vector3d::Zero();
  Eigen::Vector3d spread_m = Eigen::Vector3d::Zero();
};

/// Calibrates a prepared recording from `starts` initial rigs: the k-th is off by up to k / starts
/// of the largest error on every axis, with random signs and shares, all cameras at once. Map and
/// tracks are made once. The rig's own pose is the centre of the starts; the median of the accepted
/// results is what they are judged by, so that no truth is needed. `each_start`, where given, sees
/// after every start what is known by then; an error that it returns ends the study.
Result<std::vector<StudyCamera>> RunStudy(
    const Rig& rig, const PipelineResult& prepared, const CalibrationOptions& calibration,
    const StudyOptions& options, const ProgressCallback& progress,
    const std::function<Status(const std::vector<StudyCamera>&)>& each_start = nullptr);

/// Success by size of the initial error and the spread, for a terminal.
std::string FormatStudy(const std::vector<StudyCamera>& cameras);
/// The same as a page with plots that needs nothing else.
std::string FormatStudyPage(const std::vector<StudyCamera>& cameras);
/// One line per start and camera.
std::string FormatStudyCsv(const std::vector<StudyCamera>& cameras);

}  // namespace scenecalib
