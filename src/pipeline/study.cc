#include "scenecalib/pipeline/study.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "scenecalib/base/random.h"
#include "scenecalib/evaluation/svg_chart.h"
#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kDegreesPerRadian = 180.0 / 3.14159265358979323846;
constexpr int kNumBins = 5;

template <typename... Args>
std::string Format(const char* format, Args... args) {
  char text[512];
  std::snprintf(text, sizeof(text), format, args...);
  return text;
}

Rig StartOf(const Rig& rig, int start, const StudyOptions& options) {
  Random random =
      Random(static_cast<std::uint64_t>(options.seed)).Fork(static_cast<std::uint64_t>(start));
  const double share = static_cast<double>(start + 1) / options.starts;
  Rig moved = rig;
  for (CameraConfig& camera : moved.cameras) {
    Eigen::Vector3d turn_rad;
    Eigen::Vector3d shift_m;
    for (int k = 0; k < 3; ++k) {
      // Between half of the size and the whole, so that the k-th start has about the k-th error.
      const auto signed_share = [&random, share] {
        const double size = share * random.Uniform(0.5, 1.0);
        return random.Uniform() < 0.5 ? -size : size;
      };
      turn_rad[k] = options.max_deg / kDegreesPerRadian * signed_share();
      shift_m[k] = options.max_m * signed_share();
    }
    camera.lidar_from_camera = camera.lidar_from_camera * Rigid3(ExpSo3(turn_rad), shift_m);
  }
  return moved;
}

double Median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// The accepted results' median, parameter by parameter about one of them.
Rigid3 Middle(const std::vector<StudyCameraOutcome>& outcomes, const Rigid3& about) {
  std::vector<double> values[6];
  for (const StudyCameraOutcome& outcome : outcomes) {
    if (!outcome.accepted) continue;
    const Rigid3 change = about.Inverse() * outcome.lidar_from_camera;
    const Eigen::Vector3d turn = LogSo3(change.rotation);
    for (int k = 0; k < 3; ++k) {
      values[k].push_back(turn[k]);
      values[k + 3].push_back(change.translation[k]);
    }
  }
  if (values[0].empty()) return about;
  Eigen::Vector3d turn;
  Eigen::Vector3d shift;
  for (int k = 0; k < 3; ++k) {
    turn[k] = Median(values[k]);
    shift[k] = Median(values[k + 3]);
  }
  return about * Rigid3(ExpSo3(turn), shift);
}

void Judge(const Rigid3& initial, const StudyOptions& options, StudyCamera* camera) {
  const Rigid3 middle = Middle(camera->outcomes, initial);
  Eigen::Vector3d sum_rad2 = Eigen::Vector3d::Zero();
  Eigen::Vector3d sum_m2 = Eigen::Vector3d::Zero();
  for (StudyCameraOutcome& outcome : camera->outcomes) {
    if (!outcome.accepted) continue;
    const Rigid3 change = middle.Inverse() * outcome.lidar_from_camera;
    const Eigen::Vector3d turn = LogSo3(change.rotation);
    outcome.end_deg = kDegreesPerRadian * turn.norm();
    outcome.end_m = change.translation.norm();
    outcome.success = outcome.end_deg <= options.success_deg && outcome.end_m <= options.success_m;
    if (!outcome.success) {
      ++camera->num_accepted_elsewhere;
      continue;
    }
    ++camera->num_success;
    sum_rad2 += turn.cwiseAbs2();
    sum_m2 += change.translation.cwiseAbs2();
  }
  if (camera->num_success == 0) return;
  camera->spread_rad = (sum_rad2 / camera->num_success).cwiseSqrt();
  camera->spread_m = (sum_m2 / camera->num_success).cwiseSqrt();
}

std::vector<StudyCamera> Judged(std::vector<StudyCamera> cameras, const Rig& rig,
                                const StudyOptions& options) {
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    Judge(rig.cameras[c].lidar_from_camera, options, &cameras[c]);
  }
  return cameras;
}

/// Calibrates from one start and notes where it took the cameras.
void AddStart(const Rig& rig, const Rig& initial, const PipelineResult& prepared,
              const CalibrationOptions& calibration, std::vector<StudyCamera>* cameras) {
  MiscalibrationOptions no_rates;
  no_rates.num_times = 0;
  const Result<RigCalibration> result =
      CalibrateSegments(initial, prepared.mapping.map, prepared.segments, prepared.refusals,
                        calibration, no_rates, {});
  for (std::size_t c = 0; c < cameras->size(); ++c) {
    const Rigid3 error =
        rig.cameras[c].lidar_from_camera.Inverse() * initial.cameras[c].lidar_from_camera;
    StudyCameraOutcome outcome;
    outcome.start_deg = kDegreesPerRadian * LogSo3(error.rotation).norm();
    outcome.start_m = error.translation.norm();
    outcome.accepted = result.ok() && result->result.cameras[c].accepted;
    if (result.ok()) outcome.lidar_from_camera = result->result.rig.cameras[c].lidar_from_camera;
    (*cameras)[c].outcomes.push_back(outcome);
  }
}

struct StudyBin {
  double largest_deg = 0.0;
  double largest_m = 0.0;
  int num_starts = 0;
  int num_success = 0;
};

/// The outcomes in equal parts by the size of the initial error: they are sorted by it.
std::vector<StudyBin> BinsOf(const StudyCamera& camera) {
  std::vector<StudyBin> bins(kNumBins);
  for (std::size_t i = 0; i < camera.outcomes.size(); ++i) {
    StudyBin& bin = bins[i * kNumBins / camera.outcomes.size()];
    bin.largest_deg = std::max(bin.largest_deg, camera.outcomes[i].start_deg);
    bin.largest_m = std::max(bin.largest_m, camera.outcomes[i].start_m);
    ++bin.num_starts;
    bin.num_success += camera.outcomes[i].success ? 1 : 0;
  }
  return bins;
}

}  // namespace

Result<std::vector<StudyCamera>> RunStudy(
    const Rig& rig, const PipelineResult& prepared, const CalibrationOptions& calibration,
    const StudyOptions& options, const ProgressCallback& progress,
    const std::function<Status(const std::vector<StudyCamera>&)>& each_start) {
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  std::vector<StudyCamera> unjudged(rig.cameras.size());
  for (std::size_t c = 0; c < unjudged.size(); ++c) unjudged[c].name = rig.cameras[c].name;
  for (int start = 0; start < options.starts; ++start) {
    if (!ReportProgress(progress, "study", static_cast<double>(start) / options.starts)) {
      return Status::Cancelled("study cancelled");
    }
    AddStart(rig, StartOf(rig, start, options), prepared, calibration, &unjudged);
    if (each_start) SCENECALIB_RETURN_IF_ERROR(each_start(Judged(unjudged, rig, options)));
  }
  ReportProgress(progress, "study", 1.0);
  const std::vector<StudyCamera> cameras = Judged(unjudged, rig, options);
  const bool any = std::any_of(cameras.begin(), cameras.end(), [](const StudyCamera& camera) {
    return camera.num_success + camera.num_accepted_elsewhere > 0;
  });
  if (!any) return Status::InsufficientData("no start could be calibrated, see calibrate_bag");
  return cameras;
}

std::string FormatStudy(const std::vector<StudyCamera>& cameras) {
  std::string text = "camera            success by initial error (up to deg / cm)\n";
  for (const StudyCamera& camera : cameras) {
    text += Format("%-16s ", camera.name.c_str());
    for (const StudyBin& bin : BinsOf(camera)) {
      text += Format(" %4.1f/%4.1f: %d of %d", bin.largest_deg, 100.0 * bin.largest_m,
                     bin.num_success, bin.num_starts);
    }
    text += Format("\n%-16s  %d of %zu starts end in the same place, %d accepted elsewhere", "",
                   camera.num_success, camera.outcomes.size(), camera.num_accepted_elsewhere);
    const Eigen::Vector3d deg = kDegreesPerRadian * camera.spread_rad;
    const Eigen::Vector3d mm = 1e3 * camera.spread_m;
    text += Format(
        "\n%-16s  spread: right %.2f down %.2f forward %.2f mm, pitch %.4f yaw %.4f roll "
        "%.4f deg\n",
        "", mm[0], mm[1], mm[2], deg[0], deg[1], deg[2]);
  }
  return text;
}

std::string FormatStudyPage(const std::vector<StudyCamera>& cameras) {
  std::vector<ChartSeries> turns;
  std::vector<ChartSeries> shifts;
  std::vector<ChartSeries> success;
  for (const StudyCamera& camera : cameras) {
    ChartSeries turn{camera.name, {}, false};
    ChartSeries shift{camera.name, {}, false};
    for (const StudyCameraOutcome& outcome : camera.outcomes) {
      if (!outcome.accepted) continue;
      turn.points.emplace_back(outcome.start_deg, std::max(1e-5, outcome.end_deg));
      shift.points.emplace_back(100.0 * outcome.start_m, std::max(1e-3, 1e3 * outcome.end_m));
    }
    ChartSeries rate{camera.name, {}, true};
    for (const StudyBin& bin : BinsOf(camera)) {
      if (bin.num_starts == 0) continue;
      rate.points.emplace_back(bin.largest_deg,
                               static_cast<double>(bin.num_success) / bin.num_starts);
    }
    turns.push_back(std::move(turn));
    shifts.push_back(std::move(shift));
    success.push_back(std::move(rate));
  }
  const auto figure = [](const std::string& chart, const char* caption) {
    return "<figure>" + chart + "<figcaption>" + caption + "</figcaption></figure>";
  };
  return "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><link rel=\"icon\" "
         "href=\"data:,\"><title>scenecalib study</title><style>body{font:15px sans-serif;"
         "max-width:900px;margin:24px auto}svg{fill:#333}</style></head><body>\n"
         "<h1>Repeatability and range</h1>\n<pre>" +
         EscapeMarkup(FormatStudy(cameras)) + "</pre>\n" +
         figure(DrawChart(success, {"initial error, deg", "share of starts that succeed", false,
                                    false, true}),
                "success by size of the initial error") +
         figure(DrawChart(turns,
                          {"initial error, deg", "end, deg from the middle", true, false, false}),
                "where accepted starts end: rotation") +
         figure(DrawChart(shifts,
                          {"initial error, cm", "end, mm from the middle", true, false, false}),
                "where accepted starts end: position") +
         "</body></html>\n";
}

std::string FormatStudyCsv(const std::vector<StudyCamera>& cameras) {
  std::string text = "camera,start,start_deg,start_m,accepted,success,end_deg,end_m\n";
  for (const StudyCamera& camera : cameras) {
    for (std::size_t i = 0; i < camera.outcomes.size(); ++i) {
      const StudyCameraOutcome& o = camera.outcomes[i];
      text += camera.name + Format(",%zu,%.5f,%.5f,%d,%d,%.6f,%.6f\n", i, o.start_deg, o.start_m,
                                   o.accepted ? 1 : 0, o.success ? 1 : 0, o.end_deg, o.end_m);
    }
  }
  return text;
}

}  // namespace scenecalib
