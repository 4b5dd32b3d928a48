#include "scenecalib/pipeline/fallback.h"

#include <algorithm>
#include <utility>

#include "scenecalib/io/rig_yaml.h"

namespace scenecalib {
namespace {

/// Why the camera cannot take its values from the fallback; empty when it can.
std::string WhyNot(const CameraConfig& camera, const CalibrationResult& fallback,
                   const CameraConfig** found) {
  for (std::size_t i = 0; i < fallback.rig.cameras.size(); ++i) {
    const CameraConfig& other = fallback.rig.cameras[i];
    if (other.name != camera.name) continue;
    *found = &other;
    if (!fallback.cameras[i].accepted) return "which did not accept it either";
    if (!other.model || !camera.model || other.model->width_px() != camera.model->width_px() ||
        other.model->height_px() != camera.model->height_px()) {
      return "where its image has another size";
    }
    return {};
  }
  return "which does not have it";
}

}  // namespace

Result<std::optional<EarlierCalibration>> ReadFallback(const Rig& rig) {
  if (!rig.fallback_file) return std::optional<EarlierCalibration>();
  Result<CalibrationResult> result = ReadCalibration(*rig.fallback_file);
  if (!result.ok()) return result.status();
  return std::optional<EarlierCalibration>({*rig.fallback_file, std::move(result).value()});
}

std::vector<bool> ApplyFallback(const std::vector<EarlierCalibration>& earlier,
                                CalibrationResult* result) {
  std::vector<bool> kept(result->cameras.size(), false);
  for (std::size_t i = 0; i < result->cameras.size(); ++i) {
    CameraQuality& quality = result->cameras[i];
    CameraConfig& camera = result->rig.cameras[i];
    if (quality.accepted || earlier.empty()) continue;
    std::string reason;
    for (const EarlierCalibration& candidate : earlier) {
      const CameraConfig* found = nullptr;
      const std::string why_not = WhyNot(camera, candidate.result, &found);
      if (!why_not.empty()) {
        reason = "keeps its initial values: no fallback in " + candidate.name + ", " + why_not;
        continue;
      }
      camera.lidar_from_camera = found->lidar_from_camera;
      camera.time_offset_s = found->time_offset_s;
      camera.model = found->model;
      reason = "keeps the values of " + candidate.name;
      kept[i] = true;
      break;
    }
    quality.reasons.push_back(reason);
  }
  return kept;
}

void TakeAccepted(const CalibrationResult& result, CalibrationResult* in_force) {
  if (in_force->cameras.size() != result.cameras.size()) {
    *in_force = result;
    return;
  }
  for (std::size_t i = 0; i < result.cameras.size(); ++i) {
    if (!result.cameras[i].accepted) continue;
    in_force->rig.cameras[i] = result.rig.cameras[i];
    in_force->cameras[i] = result.cameras[i];
  }
  in_force->accepted = std::all_of(in_force->cameras.begin(), in_force->cameras.end(),
                                   [](const CameraQuality& camera) { return camera.accepted; });
}

std::string StaysInForce(const std::vector<EarlierCalibration>& earlier) {
  return earlier.empty() ? "" : "; " + earlier.front().name + " stays in force";
}

}  // namespace scenecalib
