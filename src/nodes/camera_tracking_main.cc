#include "scenecalib/ros/camera_tracking_node.h"

int main(int argc, char** argv) {
  using Created = scenecalib::Result<std::shared_ptr<void>>;
  return scenecalib::RunNode(
      argc, argv, "camera_tracking",
      [](const ros::NodeHandle& handle, const ros::NodeHandle& private_handle) {
        const auto node = scenecalib::CreateCameraTracking(handle, private_handle);
        return node.ok() ? Created(std::shared_ptr<void>(*node)) : Created(node.status());
      });
}
