#pragma once

#include <ros/message_event.h>
#include <ros/node_handle.h>
#include <tf2_msgs/TFMessage.h>

#include <map>
#include <mutex>
#include <optional>
#include <string>

namespace scenecalib {

/// Watches /tf and /tf_static for who gives which frame its parent. A frame that another node
/// already places is never fought over: two parents make every look-up of it jump. Thread-safe.
class FrameParents {
 public:
  explicit FrameParents(ros::NodeHandle handle);

  /// "base_link (from /robot_state_publisher)" when another node gives the frame a parent.
  std::optional<std::string> ParentFromOthers(const std::string& child_frame_id) const;

 private:
  void Note(const ros::MessageEvent<tf2_msgs::TFMessage const>& event);

  mutable std::mutex mutex_;
  std::map<std::string, std::string> parents_;  ///< by child, of other nodes only
  ros::Subscriber tf_;
  ros::Subscriber tf_static_;
};

}  // namespace scenecalib
