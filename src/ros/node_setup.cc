#include "scenecalib/ros/node_setup.h"

#include <ros/ros.h>

#include <exception>
#include <utility>

#include "scenecalib/base/options.h"
#include "scenecalib/io/options_yaml.h"
#include "scenecalib/io/rig_yaml.h"
#include "scenecalib/ros/log_sink.h"

namespace scenecalib {

std::string ReadText(const ros::NodeHandle& handle, const std::string& name,
                     const std::string& otherwise) {
  // NodeHandle::param is not const in older versions of roscpp.
  std::string value;
  return handle.getParam(name, value) ? value : otherwise;
}

Result<NodeSetup> ReadNodeSetup(const ros::NodeHandle& private_handle) {
  std::string rig_path;
  if (!private_handle.getParam("rig", rig_path) || rig_path.empty()) {
    return Status::NotFound("parameter " + private_handle.resolveName("rig") +
                            " is not set: give the path of the rig file");
  }
  const Result<Rig> rig = ReadRig(rig_path);
  if (!rig.ok()) return rig.status();
  NodeSetup setup{*rig, {}};
  const std::string config_path = ReadText(private_handle, "config", "");
  if (!config_path.empty()) {
    SCENECALIB_RETURN_IF_ERROR(ReadOptionsYaml(config_path, &setup.options));
  }
  for (const OptionDescription& option : DescribeOptions(setup.options)) {
    ROS_DEBUG_STREAM("option " << option.key << ": " << option.value);
  }
  return setup;
}

int RunNode(int argc, char** argv, const std::string& name,
            const std::function<Result<std::shared_ptr<void>>(
                const ros::NodeHandle& handle, const ros::NodeHandle& private_handle)>& create) {
  ros::init(argc, argv, name);
  InstallRosLogSink();
  try {
    const ros::NodeHandle handle;
    const ros::NodeHandle private_handle("~");
    const Result<std::shared_ptr<void>> node = create(handle, private_handle);
    if (!node.ok()) {
      ROS_FATAL_STREAM(name << ": " << node.status().message());
      return 1;
    }
    ros::spin();
    return 0;
  } catch (const std::exception& error) {  // no master, no memory
    ROS_FATAL_STREAM(name << ": " << error.what());
    return 1;
  }
}

}  // namespace scenecalib
