#include "scenecalib/pipeline/fallback.h"

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

void ApplyFallback(const CalibrationResult& fallback, const std::string& fallback_name,
                   CalibrationResult* result) {
  for (std::size_t i = 0; i < result->cameras.size(); ++i) {
    CameraQuality& quality = result->cameras[i];
    CameraConfig& camera = result->rig.cameras[i];
    if (quality.accepted) continue;
    const CameraConfig* found = nullptr;
    const std::string why_not = WhyNot(camera, fallback, &found);
    if (!why_not.empty()) {
      quality.reasons.push_back("keeps its initial values: no fallback in " + fallback_name + ", " +
                                why_not);
      continue;
    }
    camera.lidar_from_camera = found->lidar_from_camera;
    camera.time_offset_s = found->time_offset_s;
    camera.model = found->model;
    quality.reasons.push_back("keeps the values of " + fallback_name);
  }
}

}  // namespace scenecalib
