#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "scenecalib/base/progress.h"
#include "scenecalib/base/status.h"
#include "scenecalib/calibration/rig_calibrator.h"
#include "scenecalib/mapping/segment_mapper.h"
#include "scenecalib/pipeline/pipeline_options.h"
#include "scenecalib/pipeline/stage_cost.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/sensor/rig.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {

/// Everything that a run made.
struct PipelineResult {
  Rig initial_rig;
  MappingResult mapping;
  std::vector<CameraSegment> segments;  ///< parallel to initial_rig.cameras
  RigCalibration calibration;
  std::vector<StageCost> costs;
  /// Why a camera must not be calibrated on this recording; empty where it may. Parallel to
  /// initial_rig.cameras.
  std::vector<std::string> refusals;
  std::vector<std::string> warnings;  ///< skipped messages and the like, for a person
};

/// The stages in order (Fig. 2), fed with measurements as they come. The measurements of one sensor
/// must come in order and from one thread at a time; different sensors (the lidar with IMU and
/// odometry being one) may be fed from different threads, with the same outcome.
class CalibrationPipeline {
 public:
  /// InvalidArgument for an option out of bounds, a rig without cameras, a camera without
  /// intrinsics, or a mask image that cannot be used.
  static Result<CalibrationPipeline> Create(const Rig& rig, const PipelineOptions& options);
  CalibrationPipeline(CalibrationPipeline&&) noexcept;
  CalibrationPipeline& operator=(CalibrationPipeline&&) noexcept;
  ~CalibrationPipeline();

  void AddImu(const ImuSample& sample);
  void AddOdometry(const OdometrySample& sample);
  /// A scan or image that is refused is skipped and counted; the status says why.
  Status AddScan(const LidarScan& scan);
  Status AddImage(int camera, const GrayImage& image);
  /// Counts a message that could not even be decoded.
  void NoteRejectedScan(const std::string& reason);
  void NoteRejectedImage(int camera, const std::string& reason);

  /// Maps, tracks and calibrates what was fed. InsufficientData when nothing could be calibrated,
  /// InvalidArgument for a lidar whose stamps cannot be used. A camera that could not be calibrated
  /// keeps its initial values and says why. `known_map_from_lidar` replaces the estimated
  /// trajectory, to study its share of the error.
  Result<PipelineResult> Run(const ProgressCallback& progress,
                             const std::optional<Trajectory>& known_map_from_lidar = std::nullopt);

  /// Maps and tracks what was fed and does not calibrate: `calibration` is empty. For studies,
  /// which calibrate the same map and tracks many times (CalibrateSegments), and for judging a
  /// given rig.
  Result<PipelineResult> Prepare(
      const ProgressCallback& progress,
      const std::optional<Trajectory>& known_map_from_lidar = std::nullopt);

 private:
  struct Impl;
  explicit CalibrationPipeline(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// The last stage, with the checks that a person needs spelt out: a camera without images, or whose
/// stamps do not meet the map's time, is left at its initial values and says so. So is one with an
/// entry in `refusals` (parallel to the cameras, or empty), which then is its reason. The result
/// carries the miscalibration rates (IV-A) of the initial and of the refined rig.
Result<RigCalibration> CalibrateSegments(const Rig& initial, const SceneMap& map,
                                         std::vector<CameraSegment> segments,
                                         std::vector<std::string> refusals,
                                         const CalibrationOptions& options,
                                         const MiscalibrationOptions& miscalibration,
                                         const ProgressCallback& progress);

/// Rates the initial and the refined rig on the same images (IV-A), before and after.
Status AddMiscalibrationRates(const Rig& initial, const SceneMap& map,
                              const std::vector<CameraSegment>& segments,
                              const MiscalibrationOptions& options, CalibrationResult* result);

}  // namespace scenecalib
