#pragma once

#include <nav_msgs/Odometry.h>
#include <nav_msgs/Path.h>
#include <ros/node_handle.h>
#include <scenecalib/BuildMap.h>
#include <scenecalib/SegmentState.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/PointCloud2.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/transform_broadcaster.h>

#include <atomic>
#include <memory>
#include <string>

#include "scenecalib/mapping/segment_mapper.h"
#include "scenecalib/ros/bounded_worker.h"
#include "scenecalib/ros/frame_parents.h"
#include "scenecalib/ros/node_setup.h"

namespace scenecalib {

/// The node lidar_mapping (docs/ros_api.md): registers scans as they come, publishes map -> lidar,
/// and builds the map on request. Callbacks only queue; one worker owns the mapper, and a map is
/// built from a clone, so a long build loses no scan.
class LidarMappingNode {
 public:
  static Result<std::shared_ptr<LidarMappingNode>> Create(const ros::NodeHandle& handle,
                                                          const ros::NodeHandle& private_handle);
  LidarMappingNode(const NodeSetup& setup, const ros::NodeHandle& handle,
                   const ros::NodeHandle& private_handle);
  ~LidarMappingNode();

 private:
  void HandleScan(const sensor_msgs::PointCloud2ConstPtr& message);
  void HandleImu(const sensor_msgs::ImuConstPtr& message);
  void HandleOdometry(const nav_msgs::OdometryConstPtr& message);
  bool HandleBuildMap(BuildMapRequest& request, BuildMapResponse& response);
  bool HandleCancel(std_srvs::TriggerRequest& request, std_srvs::TriggerResponse& response);
  bool HandleReset(std_srvs::TriggerRequest& request, std_srvs::TriggerResponse& response);

  void Queue(std::function<void()> task);
  void AddScan(const sensor_msgs::PointCloud2& message);
  void Reject(const std::string& reason);
  void PublishPose(const ScanRegistration& registration);
  void PublishState(const ros::Time& stamp);
  void PublishMap(const SceneMap& map);

  const NodeSetup setup_;
  const std::string map_frame_id_;
  SegmentMapper mapper_;  ///< touched by the worker only
  SegmentState state_;    ///< the same
  nav_msgs::Path path_;   ///< the same
  std::atomic<int> num_lost_{0};
  std::atomic<bool> cancel_{false};
  std::atomic<bool> building_{false};

  FrameParents frame_parents_;
  tf2_ros::TransformBroadcaster broadcaster_;
  ros::Publisher trajectory_publisher_, map_publisher_, ground_publisher_, surfels_publisher_,
      state_publisher_;
  std::unique_ptr<BoundedWorker> worker_;
  ros::Subscriber scan_subscriber_, imu_subscriber_, odometry_subscriber_;
  ServiceThreads services_;
  ros::ServiceServer build_map_service_, cancel_service_, reset_service_;
};

}  // namespace scenecalib
