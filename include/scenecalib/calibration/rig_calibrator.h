#pragma once

#include <atomic>
#include <functional>
#include <vector>

#include "scenecalib/base/progress.h"
#include "scenecalib/base/status.h"
#include "scenecalib/calibration/calibration_evidence.h"
#include "scenecalib/calibration/calibration_options.h"
#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/mapping/ray_caster.h"
#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/sensor/rig.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {

/// A ray bundle of one track, for the eyes (RViz): the rays' origins and where they meet the plane.
struct RayBundle {
  int camera = 0;
  std::vector<Eigen::Vector3d> origins_in_map_m;
  std::vector<Eigen::Vector3d> points_in_map_m;  ///< of the same rays on the track's plane
};

struct RigCalibration {
  CalibrationResult result;
  std::vector<RayBundle> bundles_before;  ///< a bounded sample
  std::vector<RayBundle> bundles_after;
  CalibrationEvidence evidence;
};

/// Calibrates every camera of `initial` against the map (III-B to III-F). `segments` is parallel to
/// initial.cameras. InsufficientData when no camera could be calibrated; a single camera that could
/// not is returned with accepted == false and its reason.
Result<RigCalibration> CalibrateRig(const Rig& initial, const SceneMap& map,
                                    const std::vector<CameraSegment>& segments,
                                    const CalibrationOptions& options,
                                    const ProgressCallback& progress);

/// Work of the caller's that takes processors which a solve leaves idle; it stops when `cancelled`
/// becomes true.
using WorkBeside = std::function<void(const std::atomic<bool>& cancelled)>;

/// The same where the map's surfaces are at hand already. `beside_joint`, where given, runs beside
/// the joint rounds, is told when they failed, and has ended when this returns; it does not run
/// when no camera comes that far.
Result<RigCalibration> CalibrateRig(const Rig& initial, const SceneMap& map,
                                    const RayCaster& surfaces,
                                    const std::vector<CameraSegment>& segments,
                                    const CalibrationOptions& options,
                                    const ProgressCallback& progress,
                                    const WorkBeside& beside_joint = {});

}  // namespace scenecalib
