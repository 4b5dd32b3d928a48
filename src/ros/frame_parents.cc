#include "scenecalib/ros/frame_parents.h"

#include <ros/this_node.h>

namespace scenecalib {
namespace {

/// tf2 has no leading slashes, but old publishers still send them.
std::string WithoutSlash(const std::string& frame_id) {
  return !frame_id.empty() && frame_id[0] == '/' ? frame_id.substr(1) : frame_id;
}

}  // namespace

FrameParents::FrameParents(ros::NodeHandle handle)
    : tf_(handle.subscribe("/tf", 100, &FrameParents::Note, this)),
      tf_static_(handle.subscribe("/tf_static", 100, &FrameParents::Note, this)) {}

std::optional<std::string> FrameParents::ParentFromOthers(const std::string& child_frame_id) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto found = parents_.find(WithoutSlash(child_frame_id));
  if (found == parents_.end()) return std::nullopt;
  return found->second;
}

void FrameParents::Note(const ros::MessageEvent<tf2_msgs::TFMessage const>& event) {
  const std::string publisher = event.getPublisherName();
  if (publisher == ros::this_node::getName()) return;
  const std::lock_guard<std::mutex> lock(mutex_);
  for (const geometry_msgs::TransformStamped& transform : event.getMessage()->transforms) {
    parents_[WithoutSlash(transform.child_frame_id)] =
        WithoutSlash(transform.header.frame_id) + " (from " + publisher + ")";
  }
}

}  // namespace scenecalib
