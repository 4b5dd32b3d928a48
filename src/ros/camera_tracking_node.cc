#include "scenecalib/ros/camera_tracking_node.h"

#include <cv_bridge/cv_bridge.h>
#include <ros/console.h>
#include <ros/master.h>
#include <sensor_msgs/image_encodings.h>

#include <exception>
#include <utility>

#include "scenecalib/ros/message_conversion.h"
#include "scenecalib/ros/stage_messages.h"
#include "scenecalib/tracking/camera_mask.h"

namespace scenecalib {
namespace {

/// Waiting images: a few seconds at the usual rates.
constexpr std::size_t kQueueLength = 50;

}  // namespace

CameraTrackingNode::CameraTrackingNode(const CameraConfig& camera, const cv::Mat& mask,
                                       const TrackingOptions& options,
                                       const ros::NodeHandle& handle)
    : camera_(camera),
      mask_(mask),
      options_(options),
      topics_(handle),
      services_(ros::NodeHandle(handle, "camera_tracking/" + camera.name), 1) {
  if (camera_.model) tracker_.emplace(camera_.name, camera_.model, options_, mask_);
  state_.sensor = camera_.name;
  ros::NodeHandle own(handle, "camera_tracking/" + camera.name);
  state_publisher_ = own.advertise<SegmentState>("state", 1, true);
  debug_publisher_ = own.advertise<sensor_msgs::Image>("debug_image", 1);
  worker_ = std::make_unique<BoundedWorker>(kQueueLength);
  if (!camera_.model && camera_.camera_info_topic) {
    info_subscriber_ =
        topics_.subscribe(*camera_.camera_info_topic, 5, &CameraTrackingNode::HandleInfo, this);
  }
  type_timer_ = topics_.createWallTimer(ros::WallDuration(0.2),
                                        &CameraTrackingNode::SubscribeWhenTypeIsKnown, this);
  get_segment_service_ =
      services_.handle.advertiseService("get_segment", &CameraTrackingNode::HandleGetSegment, this);
  reset_service_ =
      services_.handle.advertiseService("reset", &CameraTrackingNode::HandleReset, this);
  services_.Start();
}

CameraTrackingNode::~CameraTrackingNode() {
  services_.Stop();
  type_timer_.stop();
  image_subscriber_.shutdown();
  info_subscriber_.shutdown();
  worker_->Finish();
}

void CameraTrackingNode::SubscribeWhenTypeIsKnown(const ros::WallTimerEvent& /*event*/) {
  ros::master::V_TopicInfo published;
  if (!ros::master::getTopics(published)) return;
  const std::string topic = topics_.resolveName(camera_.image_topic);
  for (const ros::master::TopicInfo& info : published) {
    if (info.name != topic) continue;
    if (info.datatype == ros::message_traits::DataType<sensor_msgs::CompressedImage>::value()) {
      image_subscriber_ = topics_.subscribe(topic, 20, &CameraTrackingNode::HandleCompressed, this);
    } else if (info.datatype == ros::message_traits::DataType<sensor_msgs::Image>::value()) {
      image_subscriber_ = topics_.subscribe(topic, 20, &CameraTrackingNode::HandleRaw, this);
    } else {
      ROS_ERROR_STREAM_THROTTLE(10.0, "camera " << camera_.name << ": topic " << topic
                                                << " is of type " << info.datatype
                                                << ", not Image or CompressedImage");
      return;
    }
    type_timer_.stop();
    return;
  }
}

void CameraTrackingNode::Queue(std::function<void()> task) {
  const bool queued = worker_->TryPush([this, task = std::move(task)] {
    try {
      task();
    } catch (const std::exception& error) {  // no input may end the node
      ROS_ERROR_STREAM("camera " << camera_.name << ": image dropped: " << error.what());
    }
  });
  if (queued) return;
  ++num_lost_;
  ROS_WARN_STREAM_THROTTLE(5.0, "camera " << camera_.name << ": tracking cannot keep up, "
                                          << num_lost_ << " images lost");
}

void CameraTrackingNode::HandleInfo(const sensor_msgs::CameraInfoConstPtr& message) {
  info_subscriber_.shutdown();  // the first one counts
  Queue([this, message] {
    const Result<CameraModelPtr> model = CameraModelFromInfo(*message);
    if (!model.ok()) {
      state_.last_problem = model.status().message();
      ROS_ERROR_STREAM("camera " << camera_.name << ": " << state_.last_problem);
      return;
    }
    info_ = *message;
    tracker_.emplace(camera_.name, *model, options_, mask_);
  });
}

void CameraTrackingNode::HandleRaw(const sensor_msgs::ImageConstPtr& message) {
  Queue([this, message] { AddImage(converter_.Convert(*message)); });
}

void CameraTrackingNode::HandleCompressed(const sensor_msgs::CompressedImageConstPtr& message) {
  Queue([this, message] { AddImage(converter_.Convert(*message)); });
}

void CameraTrackingNode::AddImage(const Result<GrayImage>& image) {
  ++state_.num_measurements;
  Status status = image.status();
  if (status.ok() && !tracker_) {
    status = Status::NotFound("no intrinsics yet: no message on " +
                              camera_.camera_info_topic.value_or("camera_info_topic"));
  }
  if (status.ok()) status = tracker_->AddImage(*image).status();
  if (!status.ok()) {
    ++state_.num_rejected;
    state_.last_problem = status.message();
    ROS_WARN_STREAM_THROTTLE(5.0,
                             "camera " << camera_.name << ": image skipped: " << status.message());
  }
  state_.header.frame_id = camera_.frame_id;
  if (image.ok()) state_.header.stamp = ToRosTime(image->stamp_ns);
  state_.num_lost = num_lost_;
  state_publisher_.publish(state_);
  if (!status.ok() || debug_publisher_.getNumSubscribers() == 0) return;
  const cv::Mat drawing = tracker_->DebugImage();
  if (drawing.empty()) return;
  debug_publisher_.publish(
      cv_bridge::CvImage(state_.header, sensor_msgs::image_encodings::BGR8, drawing).toImageMsg());
}

bool CameraTrackingNode::HandleGetSegment(GetSegmentRequest& /*request*/,
                                          GetSegmentResponse& response) {
  CameraSegment segment;
  worker_->RunInTurn([this, &segment, &response] {
    try {
      if (tracker_) segment = tracker_->Segment();
      response.success = tracker_.has_value();
      if (!tracker_) response.message = "no intrinsics: " + state_.last_problem;
    } catch (const std::exception& error) {
      response.message = std::string("tracks could not be verified: ") + error.what();
    }
    response.has_camera_info = info_.has_value();
    if (info_) response.camera_info = *info_;
  });
  try {
    FillSegment(segment, &response);
  } catch (const std::exception& error) {
    response.success = false;
    response.message = std::string("images could not be packed: ") + error.what();
  }
  return true;
}

bool CameraTrackingNode::HandleReset(std_srvs::TriggerRequest& /*request*/,
                                     std_srvs::TriggerResponse& response) {
  worker_->RunInTurn([this] {
    if (tracker_) tracker_->Reset();
    state_ = SegmentState();
    state_.sensor = camera_.name;
    num_lost_ = 0;
    state_publisher_.publish(state_);
  });
  response.success = true;
  response.message = "the segment of camera " + camera_.name + " is empty";
  return true;
}

Result<std::shared_ptr<std::vector<std::unique_ptr<CameraTrackingNode>>>> CreateCameraTracking(
    const ros::NodeHandle& handle, const ros::NodeHandle& private_handle) {
  const Result<NodeSetup> setup = ReadNodeSetup(private_handle);
  if (!setup.ok()) return setup.status();
  const std::string wanted = ReadText(private_handle, "camera", "");
  auto nodes = std::make_shared<std::vector<std::unique_ptr<CameraTrackingNode>>>();
  for (const CameraConfig& camera : setup->rig.cameras) {
    if (!wanted.empty() && camera.name != wanted) continue;
    const Result<cv::Mat> mask = ReadCameraMask(camera);
    if (!mask.ok()) return mask.status();
    nodes->push_back(
        std::make_unique<CameraTrackingNode>(camera, *mask, setup->options.tracking, handle));
  }
  if (nodes->empty()) {
    return Status::NotFound("parameter " + private_handle.resolveName("camera") +
                            ": the rig has no camera \"" + wanted + "\"");
  }
  return nodes;
}

}  // namespace scenecalib
