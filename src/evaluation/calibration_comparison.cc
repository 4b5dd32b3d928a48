#include "scenecalib/evaluation/calibration_comparison.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <optional>

#include "scenecalib/geometry/so3.h"
#include "scenecalib/sensor/lens_shape.h"

namespace scenecalib {
namespace {

constexpr double kDegreesPerRadian = 180.0 / 3.14159265358979323846;

std::optional<std::size_t> IndexOf(const CalibrationResult& result, const std::string& name) {
  for (std::size_t i = 0; i < result.rig.cameras.size(); ++i) {
    if (result.rig.cameras[i].name == name) return i;
  }
  return std::nullopt;
}

class Collector {
 public:
  Collector(const ComparisonLimits& limits, CameraChange* change)
      : limits_(limits), change_(change) {}

  void Add(const char* parameter, const char* unit, double scale, double change, double first,
           double second) {
    const double stddev = limits_.stddev_factor * std::hypot(first, second);
    // Held at the same value in both, or never estimated.
    if (!(stddev > 0.0) && change == 0.0) return;
    ParameterChange entry{parameter, unit, scale * change, scale * stddev};
    entry.sigmas =
        stddev > 0.0 ? std::abs(change) / stddev : std::numeric_limits<double>::infinity();
    entry.moved = entry.sigmas > limits_.sigmas;
    change_->moved |= entry.moved;
    change_->parameters.push_back(entry);
  }

 private:
  const ComparisonLimits& limits_;
  CameraChange* change_;
};

void ComparePose(const CameraConfig& a, const CameraStddev& sigma_a, const CameraConfig& b,
                 const CameraStddev& sigma_b, Collector* collect) {
  static const char* const kShifts[] = {"shift right", "shift down", "shift forward"};
  static const char* const kTurns[] = {"turn pitch", "turn yaw", "turn roll"};
  const Rigid3 first_from_second = a.lidar_from_camera.Inverse() * b.lidar_from_camera;
  const Eigen::Vector3d turn_rad = LogSo3(first_from_second.rotation);
  for (int k = 0; k < 3; ++k) {
    collect->Add(kShifts[k], "cm", 100.0, first_from_second.translation[k],
                 sigma_a.translation_m[k], sigma_b.translation_m[k]);
  }
  for (int k = 0; k < 3; ++k) {
    collect->Add(kTurns[k], "deg", kDegreesPerRadian, turn_rad[k], sigma_a.rotation_rad[k],
                 sigma_b.rotation_rad[k]);
  }
}

void CompareCamera(const CameraConfig& a, const CameraQuality& quality_a, const CameraConfig& b,
                   const CameraQuality& quality_b, const ComparisonLimits& limits,
                   CameraChange* change) {
  if (!quality_a.accepted || !quality_b.accepted) {
    change->problem = std::string("not accepted in the ") +
                      (quality_a.accepted ? "second" : "first") + " calibration";
    return;
  }
  Collector collect(limits, change);
  const CameraStddev& sigma_a = quality_a.stddev;
  const CameraStddev& sigma_b = quality_b.stddev;
  ComparePose(a, sigma_a, b, sigma_b, &collect);
  collect.Add("time offset", "ms", 1e3, b.time_offset_s - a.time_offset_s, sigma_a.time_offset_s,
              sigma_b.time_offset_s);
  if (!a.model || !b.model) return;
  if (a.model->name() != b.model->name()) {
    change->problem = "lens models differ (" + a.model->name() + ", " + b.model->name() + ")";
    return;
  }
  collect.Add("focal scale", "%", 100.0, FocalAtAxisPx(*b.model) / FocalAtAxisPx(*a.model) - 1.0,
              sigma_a.focal_scale, sigma_b.focal_scale);
  static const char* const kCenters[] = {"principal point x", "principal point y"};
  for (int k = 0; k < 2; ++k) {
    collect.Add(kCenters[k], "px", 1.0,
                b.model->tunable().principal_point_px[k] - a.model->tunable().principal_point_px[k],
                sigma_a.principal_point_px[k], sigma_b.principal_point_px[k]);
  }
}

std::string Describe(const ParameterChange& change) {
  char text[160];
  std::snprintf(text, sizeof(text), "%s %+.3f %s (%.1f sigma)", change.parameter.c_str(),
                change.change, change.unit.c_str(), change.sigmas);
  return text;
}

}  // namespace

std::vector<CameraChange> CompareCalibrations(const CalibrationResult& first,
                                              const CalibrationResult& second,
                                              const ComparisonLimits& limits) {
  std::vector<CameraChange> changes;
  for (std::size_t i = 0; i < first.rig.cameras.size(); ++i) {
    CameraChange change;
    change.camera = first.rig.cameras[i].name;
    const auto other = IndexOf(second, change.camera);
    if (!other) {
      change.problem = "not in the second calibration";
    } else {
      CompareCamera(first.rig.cameras[i], first.cameras[i], second.rig.cameras[*other],
                    second.cameras[*other], limits, &change);
    }
    changes.push_back(std::move(change));
  }
  for (const CameraConfig& camera : second.rig.cameras) {
    if (IndexOf(first, camera.name)) continue;
    CameraChange change;
    change.camera = camera.name;
    change.problem = "not in the first calibration";
    changes.push_back(std::move(change));
  }
  return changes;
}

std::string FormatChanges(const std::vector<CameraChange>& changes) {
  std::string text;
  for (const CameraChange& change : changes) {
    text += change.camera + ": ";
    if (!change.problem.empty()) {
      text += change.problem + "\n";
      continue;
    }
    std::string moved;
    for (const ParameterChange& parameter : change.parameters) {
      if (parameter.moved) moved += (moved.empty() ? "" : ", ") + Describe(parameter);
    }
    text += moved.empty() ? "did not move\n" : "moved: " + moved + "\n";
  }
  text += "\n";
  for (const CameraChange& change : changes) {
    for (const ParameterChange& parameter : change.parameters) {
      char line[200];
      std::snprintf(line, sizeof(line), "%-16s %-18s %+10.4f +- %-9.4f %-4s %6.1f sigma%s\n",
                    change.camera.c_str(), parameter.parameter.c_str(), parameter.change,
                    parameter.stddev, parameter.unit.c_str(), parameter.sigmas,
                    parameter.moved ? "  moved" : "");
      text += line;
    }
  }
  return text;
}

}  // namespace scenecalib
