#pragma once

#include <ros/node_handle.h>
#include <scenecalib/GetSegment.h>
#include <scenecalib/SegmentState.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <std_srvs/Trigger.h>

#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "scenecalib/ros/bounded_worker.h"
#include "scenecalib/ros/image_conversion.h"
#include "scenecalib/ros/node_setup.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {

/// One camera of the node camera_tracking (docs/ros_api.md): tracks features as images come and
/// hands the segment out on request. Its topics and services lie under camera_tracking/<camera>.
/// Callbacks only queue; one worker owns the tracker.
class CameraTrackingNode {
 public:
  CameraTrackingNode(const CameraConfig& camera, const cv::Mat& mask,
                     const TrackingOptions& options, const ros::NodeHandle& handle);
  ~CameraTrackingNode();

 private:
  void SubscribeWhenTypeIsKnown(const ros::WallTimerEvent& event);
  void HandleInfo(const sensor_msgs::CameraInfoConstPtr& message);
  void HandleRaw(const sensor_msgs::ImageConstPtr& message);
  void HandleCompressed(const sensor_msgs::CompressedImageConstPtr& message);
  bool HandleGetSegment(GetSegmentRequest& request, GetSegmentResponse& response);
  bool HandleReset(std_srvs::TriggerRequest& request, std_srvs::TriggerResponse& response);

  void Queue(std::function<void()> task);
  void AddImage(const Result<GrayImage>& image);

  const CameraConfig camera_;
  const cv::Mat mask_;  ///< of the user, or empty
  const TrackingOptions options_;
  std::optional<CameraTracker> tracker_;         ///< none until the intrinsics are known
  ImageConverter converter_;                     ///< touched by the worker only, as what follows
  std::optional<sensor_msgs::CameraInfo> info_;  ///< that gave the intrinsics
  SegmentState state_;
  std::atomic<int> num_lost_{0};

  ros::NodeHandle topics_;
  ros::Publisher state_publisher_, debug_publisher_;
  std::unique_ptr<BoundedWorker> worker_;
  ros::Subscriber image_subscriber_, info_subscriber_;
  ros::WallTimer type_timer_;
  ServiceThreads services_;
  ros::ServiceServer get_segment_service_, reset_service_;
};

/// The camera that the parameter ~camera names, or every camera of the rig. NotFound when the rig
/// has no such camera.
Result<std::shared_ptr<std::vector<std::unique_ptr<CameraTrackingNode>>>> CreateCameraTracking(
    const ros::NodeHandle& handle, const ros::NodeHandle& private_handle);

}  // namespace scenecalib
