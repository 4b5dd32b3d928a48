#include "scenecalib/ros/calibration_server_node.h"

int main(int argc, char** argv) {
  using scenecalib::CalibrationServerNode;
  using Created = scenecalib::Result<std::shared_ptr<void>>;
  return scenecalib::RunNode(
      argc, argv, "calibration_server",
      [](const ros::NodeHandle& handle, const ros::NodeHandle& private_handle) {
        const auto node = CalibrationServerNode::Create(handle, private_handle);
        return node.ok() ? Created(std::shared_ptr<void>(*node)) : Created(node.status());
      });
}
