#include "scenecalib/ros/lidar_mapping_node.h"

#include <ros/console.h>
#include <visualization_msgs/Marker.h>

#include <exception>
#include <optional>
#include <utility>

#include "scenecalib/ros/message_conversion.h"
#include "scenecalib/ros/point_cloud_conversion.h"
#include "scenecalib/ros/stage_messages.h"
#include "scenecalib/ros/visualization.h"

namespace scenecalib {
namespace {

/// Waiting messages of lidar, IMU and odometry together: some seconds of driving.
constexpr std::size_t kQueueLength = 2000;
constexpr std::size_t kMaxPathPoses = 20000;

}  // namespace

Result<std::shared_ptr<LidarMappingNode>> LidarMappingNode::Create(
    const ros::NodeHandle& handle, const ros::NodeHandle& private_handle) {
  const Result<NodeSetup> setup = ReadNodeSetup(private_handle);
  if (!setup.ok()) return setup.status();
  return std::make_shared<LidarMappingNode>(*setup, handle, private_handle);
}

LidarMappingNode::LidarMappingNode(const NodeSetup& setup, const ros::NodeHandle& handle,
                                   const ros::NodeHandle& private_handle)
    : setup_(setup),
      map_frame_id_(ReadText(private_handle, "map_frame", "map")),
      mapper_(setup.rig, setup.options.mapping),
      frame_parents_(handle),
      services_(private_handle) {
  ros::NodeHandle topics = handle;
  ros::NodeHandle own = private_handle;
  state_.sensor = "lidar";
  path_.header.frame_id = map_frame_id_;
  trajectory_publisher_ = own.advertise<nav_msgs::Path>("trajectory", 1, true);
  map_publisher_ = own.advertise<sensor_msgs::PointCloud2>("map", 1, true);
  ground_publisher_ = own.advertise<visualization_msgs::Marker>("ground", 1, true);
  surfels_publisher_ = own.advertise<visualization_msgs::Marker>("surfels", 1, true);
  state_publisher_ = own.advertise<SegmentState>("state", 1, true);
  worker_ = std::make_unique<BoundedWorker>(kQueueLength);
  scan_subscriber_ =
      topics.subscribe(setup.rig.lidar.topic, 20, &LidarMappingNode::HandleScan, this);
  if (setup.rig.imu) {
    imu_subscriber_ =
        topics.subscribe(setup.rig.imu->topic, 1000, &LidarMappingNode::HandleImu, this);
  }
  if (setup.rig.odometry) {
    odometry_subscriber_ =
        topics.subscribe(setup.rig.odometry->topic, 1000, &LidarMappingNode::HandleOdometry, this);
  }
  build_map_service_ =
      services_.handle.advertiseService("build_map", &LidarMappingNode::HandleBuildMap, this);
  cancel_service_ =
      services_.handle.advertiseService("cancel", &LidarMappingNode::HandleCancel, this);
  reset_service_ = services_.handle.advertiseService("reset", &LidarMappingNode::HandleReset, this);
  services_.Start();
}

LidarMappingNode::~LidarMappingNode() {
  cancel_ = true;
  services_.Stop();
  scan_subscriber_.shutdown();
  imu_subscriber_.shutdown();
  odometry_subscriber_.shutdown();
  worker_->Finish();
}

void LidarMappingNode::Queue(std::function<void()> task) {
  const bool queued = worker_->TryPush([task = std::move(task)] {
    try {
      task();
    } catch (const std::exception& error) {  // no input may end the node
      ROS_ERROR_STREAM("lidar_mapping: message dropped: " << error.what());
    }
  });
  if (queued) return;
  ++num_lost_;
  ROS_WARN_STREAM_THROTTLE(5.0, "lidar_mapping cannot keep up: " << num_lost_ << " messages lost");
}

void LidarMappingNode::HandleScan(const sensor_msgs::PointCloud2ConstPtr& message) {
  Queue([this, message] { AddScan(*message); });
}

void LidarMappingNode::HandleImu(const sensor_msgs::ImuConstPtr& message) {
  const Result<ImuSample> sample = FromMessage(*message);
  if (!sample.ok()) {
    ROS_WARN_STREAM_THROTTLE(5.0, setup_.rig.imu->topic << ": " << sample.status().message());
    return;
  }
  Queue([this, sample] { mapper_.AddImu(*sample); });
}

void LidarMappingNode::HandleOdometry(const nav_msgs::OdometryConstPtr& message) {
  const Result<OdometrySample> sample = FromMessage(*message);
  if (!sample.ok()) {
    ROS_WARN_STREAM_THROTTLE(5.0, setup_.rig.odometry->topic << ": " << sample.status().message());
    return;
  }
  Queue([this, sample] { mapper_.AddOdometry(*sample); });
}

void LidarMappingNode::AddScan(const sensor_msgs::PointCloud2& message) {
  ++state_.num_measurements;
  const Result<LidarScan> scan = DecodeScan(message, setup_.rig.lidar);
  const Result<ScanRegistration> registration =
      scan.ok() ? mapper_.AddScan(*scan) : Result<ScanRegistration>(scan.status());
  if (registration.ok()) {
    PublishPose(*registration);
  } else {
    Reject(registration.status().message());
  }
  PublishState(message.header.stamp);
}

void LidarMappingNode::Reject(const std::string& reason) {
  ++state_.num_rejected;
  state_.last_problem = reason;
  ROS_WARN_STREAM_THROTTLE(5.0, "scan skipped: " << reason);
}

void LidarMappingNode::PublishPose(const ScanRegistration& registration) {
  geometry_msgs::PoseStamped pose;
  pose.header.frame_id = map_frame_id_;
  pose.header.stamp = ToRosTime(registration.stamp_ns);
  pose.pose = ToPoseMessage(registration.map_from_lidar);
  if (path_.poses.size() < kMaxPathPoses) path_.poses.push_back(pose);
  path_.header.stamp = pose.header.stamp;
  trajectory_publisher_.publish(path_);

  const std::string& lidar_frame_id = setup_.rig.lidar.frame_id;
  const std::optional<std::string> other = frame_parents_.ParentFromOthers(lidar_frame_id);
  if (other) {
    ROS_WARN_STREAM_ONCE("frame " << lidar_frame_id << " already has the parent " << *other << ": "
                                  << map_frame_id_ << " -> " << lidar_frame_id
                                  << " is not published");
    return;
  }
  geometry_msgs::TransformStamped transform;
  transform.header = pose.header;
  transform.child_frame_id = lidar_frame_id;
  transform.transform = ToTransformMessage(registration.map_from_lidar);
  broadcaster_.sendTransform(transform);
}

void LidarMappingNode::PublishState(const ros::Time& stamp) {
  state_.header.stamp = stamp;
  state_.header.frame_id = setup_.rig.lidar.frame_id;
  state_.num_lost = num_lost_;
  state_publisher_.publish(state_);
}

void LidarMappingNode::PublishMap(const SceneMap& map) {
  map_publisher_.publish(MapCloud(map.points, map_frame_id_));
  ground_publisher_.publish(GroundMarker(map.ground, map_frame_id_));
  surfels_publisher_.publish(SurfelMarker(map.surfels, map_frame_id_));
  trajectory_publisher_.publish(TrajectoryPath(map.map_from_lidar, map_frame_id_));
}

bool LidarMappingNode::HandleBuildMap(BuildMapRequest& /*request*/, BuildMapResponse& response) {
  if (building_.exchange(true)) {
    response.message = "a map is already being built";
    return true;
  }
  cancel_ = false;
  std::optional<SegmentMapper> clone;
  worker_->RunInTurn([this, &clone] { clone.emplace(mapper_.Clone()); });
  try {
    const Result<MappingResult> result =
        clone->BuildMap([this](const Progress&) { return !cancel_; });
    response.success = result.ok();
    response.message = result.status().message();
    if (result.ok()) {
      response.map = ToMessage(result->map, map_frame_id_);
      response.warnings = result->report.warnings;
      response.path_length_m = result->report.path_length_m;
      response.surface_thickness_m = result->report.thickness_after_m;
      PublishMap(result->map);
    }
  } catch (const std::exception& error) {
    response.success = false;
    response.message = std::string("building the map failed: ") + error.what();
  }
  building_ = false;
  return true;
}

bool LidarMappingNode::HandleCancel(std_srvs::TriggerRequest& /*request*/,
                                    std_srvs::TriggerResponse& response) {
  cancel_ = true;
  response.success = true;
  response.message = building_ ? "the map's building is being stopped" : "nothing was being built";
  return true;
}

bool LidarMappingNode::HandleReset(std_srvs::TriggerRequest& /*request*/,
                                   std_srvs::TriggerResponse& response) {
  worker_->RunInTurn([this] {
    mapper_.Reset();
    path_.poses.clear();
    state_ = SegmentState();
    state_.sensor = "lidar";
    num_lost_ = 0;
    PublishState(ros::Time(0));
  });
  response.success = true;
  response.message = "the lidar's segment is empty";
  return true;
}

}  // namespace scenecalib
