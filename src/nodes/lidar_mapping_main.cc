#include "scenecalib/ros/lidar_mapping_node.h"

int main(int argc, char** argv) {
  using scenecalib::LidarMappingNode;
  using Created = scenecalib::Result<std::shared_ptr<void>>;
  return scenecalib::RunNode(
      argc, argv, "lidar_mapping",
      [](const ros::NodeHandle& handle, const ros::NodeHandle& private_handle) {
        const auto node = LidarMappingNode::Create(handle, private_handle);
        return node.ok() ? Created(std::shared_ptr<void>(*node)) : Created(node.status());
      });
}
