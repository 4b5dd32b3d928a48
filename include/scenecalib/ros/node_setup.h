#pragma once

#include <ros/callback_queue.h>
#include <ros/node_handle.h>
#include <ros/spinner.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "scenecalib/base/status.h"
#include "scenecalib/pipeline/pipeline_options.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// What every node is started with: the parameters ~rig (file, required) and ~config (options file,
/// optional).
struct NodeSetup {
  Rig rig;
  PipelineOptions options;
};

/// The text of a parameter, `otherwise` where it is not set or no text.
std::string ReadText(const ros::NodeHandle& handle, const std::string& name,
                     const std::string& otherwise);

/// NotFound or InvalidArgument naming the parameter, or file, key, value and bound.
Result<NodeSetup> ReadNodeSetup(const ros::NodeHandle& private_handle);

/// A queue with threads of its own for services, so that a long call neither blocks topics nor
/// another service (cancel), however few threads the process or nodelet manager has.
class ServiceThreads {
 public:
  explicit ServiceThreads(const ros::NodeHandle& parent, int num_threads = 3)
      : handle(parent), spinner_(static_cast<std::uint32_t>(num_threads), &queue_) {
    handle.setCallbackQueue(&queue_);
  }
  ~ServiceThreads() { Stop(); }
  /// Call when every service is advertised.
  void Start() { spinner_.start(); }
  void Stop() { spinner_.stop(); }

  ros::NodeHandle handle;

 private:
  ros::CallbackQueue queue_;
  ros::AsyncSpinner spinner_;
};

/// Runs a node's main: initialises ROS under `name`, builds the node with `create` (which returns
/// what must stay alive) and spins until shutdown. Returns the exit status: 1, with a line on the
/// console, when `create` says why the node cannot start.
int RunNode(int argc, char** argv, const std::string& name,
            const std::function<Result<std::shared_ptr<void>>(
                const ros::NodeHandle& handle, const ros::NodeHandle& private_handle)>& create);

}  // namespace scenecalib
