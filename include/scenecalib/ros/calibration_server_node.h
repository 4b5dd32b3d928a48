#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/node_handle.h>
#include <scenecalib/CalibrationStatus.h>
#include <scenecalib/GetCalibration.h>
#include <scenecalib/Recalibrate.h>
#include <scenecalib/Save.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/static_transform_broadcaster.h>

#include <atomic>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "scenecalib/calibration/rig_calibrator.h"
#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/pipeline/fallback.h"
#include "scenecalib/ros/frame_parents.h"
#include "scenecalib/ros/node_setup.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {

/// The node calibration_server (docs/ros_api.md): on request collects the map from lidar_mapping
/// and the segments from camera_tracking, calibrates, and publishes the result: tf lidar -> camera,
/// the calibration (latched), pictures for RViz.
class CalibrationServerNode {
 public:
  static Result<std::shared_ptr<CalibrationServerNode>> Create(
      const ros::NodeHandle& handle, const ros::NodeHandle& private_handle);
  CalibrationServerNode(const NodeSetup& setup, const ros::NodeHandle& handle,
                        const ros::NodeHandle& private_handle,
                        const std::optional<EarlierCalibration>& fallback);
  ~CalibrationServerNode();

 private:
  /// What a run needs from the other nodes.
  struct Inputs {
    Rig rig;  ///< with every camera's model
    SceneMap map;
    std::string map_frame_id;
    std::vector<CameraSegment> segments;
    /// Why a camera must not be calibrated on this (IV-D); empty where it may.
    std::vector<std::string> refusals;
  };

  bool HandleRecalibrate(RecalibrateRequest& request, RecalibrateResponse& response);
  bool HandleCancel(std_srvs::TriggerRequest& request, std_srvs::TriggerResponse& response);
  bool HandleSave(SaveRequest& request, SaveResponse& response);
  bool HandleGet(GetCalibrationRequest& request, GetCalibrationResponse& response);
  bool HandleReset(std_srvs::TriggerRequest& request, std_srvs::TriggerResponse& response);

  Status Recalibrate(RecalibrateResponse* response);
  /// Newest first: what this server accepted, the rig file's fallback.
  std::vector<EarlierCalibration> Earlier();
  /// Everything that was decided about every camera, for a person.
  void Answer(const CalibrationResult& result, const std::string& note,
              RecalibrateResponse* response);
  Result<Inputs> CollectInputs();
  Status CollectMap(Inputs* inputs);
  Status CollectSegment(std::size_t camera, Inputs* inputs);
  bool OnProgress(const Progress& progress);

  void Publish(const Inputs& inputs, const RigCalibration& calibration);
  void PublishPictures(const Inputs& inputs, const RigCalibration& calibration);
  /// Says which camera frames were left alone because another node places them.
  std::string PublishTransforms(const CalibrationResult& result, const std::vector<bool>& in_force);
  void PublishStatus(std::uint8_t state, const std::string& stage, double fraction,
                     const std::string& message);
  void Diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  const NodeSetup setup_;
  const std::string output_path_;
  const std::optional<EarlierCalibration> fallback_;  ///< of the rig file
  ros::NodeHandle handle_;
  std::atomic<bool> running_{false};
  std::atomic<bool> cancel_{false};

  std::mutex mutex_;  ///< guards the three below
  std::optional<CalibrationResult> last_result_;
  CalibrationResult accepted_;  ///< every camera as it was last accepted here
  CalibrationStatus status_;

  FrameParents frame_parents_;
  tf2_ros::StaticTransformBroadcaster broadcaster_;
  ros::Publisher calibration_publisher_, status_publisher_, coloured_cloud_publisher_,
      bundles_before_publisher_, bundles_after_publisher_, frusta_publisher_;
  std::map<std::string, ros::Publisher> overlay_publishers_;  ///< by topic
  diagnostic_updater::Updater updater_;
  ros::WallTimer diagnostics_timer_;
  ServiceThreads services_;
  std::vector<ros::ServiceServer> servers_;
};

}  // namespace scenecalib
