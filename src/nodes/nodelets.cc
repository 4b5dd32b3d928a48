#include <nodelet/nodelet.h>

#include <pluginlib/class_list_macros.hpp>

#include "scenecalib/ros/calibration_server_node.h"
#include "scenecalib/ros/camera_tracking_node.h"
#include "scenecalib/ros/lidar_mapping_node.h"

namespace scenecalib {

/// A nodelet around what `create` returns; one that cannot start says why and stays empty.
template <auto create>
class SceneCalibNodelet : public nodelet::Nodelet {
  void onInit() override {
    const auto created = create(getMTNodeHandle(), getMTPrivateNodeHandle());
    if (created.ok()) {
      node_ = *created;
    } else {
      NODELET_FATAL_STREAM(getName() << ": " << created.status().message());
    }
  }
  std::shared_ptr<void> node_;
};

using LidarMappingNodelet = SceneCalibNodelet<&LidarMappingNode::Create>;
using CameraTrackingNodelet = SceneCalibNodelet<&CreateCameraTracking>;
using CalibrationServerNodelet = SceneCalibNodelet<&CalibrationServerNode::Create>;

}  // namespace scenecalib

PLUGINLIB_EXPORT_CLASS(scenecalib::LidarMappingNodelet, nodelet::Nodelet)
PLUGINLIB_EXPORT_CLASS(scenecalib::CameraTrackingNodelet, nodelet::Nodelet)
PLUGINLIB_EXPORT_CLASS(scenecalib::CalibrationServerNodelet, nodelet::Nodelet)
