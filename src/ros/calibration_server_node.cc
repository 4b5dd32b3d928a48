#include "scenecalib/ros/calibration_server_node.h"

#include <cv_bridge/cv_bridge.h>
#include <ros/console.h>
#include <scenecalib/BuildMap.h>
#include <scenecalib/GetSegment.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>
#include <visualization_msgs/Marker.h>

#include <algorithm>
#include <exception>
#include <utility>

#include "scenecalib/io/rig_yaml.h"
#include "scenecalib/pipeline/calibration_pipeline.h"
#include "scenecalib/pipeline/fitness.h"
#include "scenecalib/pipeline/overlays.h"
#include "scenecalib/ros/image_conversion.h"
#include "scenecalib/ros/message_conversion.h"
#include "scenecalib/ros/stage_messages.h"
#include "scenecalib/ros/visualization.h"

// Reading order: Create, the services, Recalibrate with its Collect* helpers, then Publish*.
namespace scenecalib {
namespace {

constexpr double kServiceWait_s = 5.0;
constexpr double kFrustumDepth_m = 1.0;
constexpr int kImagesPerOverlay = 1;  // RViz shows them small

std::string SegmentService(const std::string& camera, const std::string& name) {
  return "camera_tracking/" + camera + "/" + name;
}

/// Calls a service of another node. Unavailable, naming it, when nobody answers.
template <typename Service>
Status CallService(ros::NodeHandle* handle, const std::string& name, Service* service) {
  const std::string resolved = handle->resolveName(name);
  if (!ros::service::waitForService(resolved, ros::Duration(kServiceWait_s))) {
    return Status::Unavailable("nobody offers the service " + resolved +
                               ": start the node (calibration.launch)");
  }
  if (!handle->serviceClient<Service>(name).call(*service)) {
    return Status::Unavailable("the service " + resolved + " failed: see that node's log");
  }
  return Status::Ok();
}

}  // namespace

Result<std::shared_ptr<CalibrationServerNode>> CalibrationServerNode::Create(
    const ros::NodeHandle& handle, const ros::NodeHandle& private_handle) {
  const Result<NodeSetup> setup = ReadNodeSetup(private_handle);
  if (!setup.ok()) return setup.status();
  const auto fallback = ReadFallback(setup->rig);
  if (!fallback.ok()) return fallback.status();
  return std::make_shared<CalibrationServerNode>(*setup, handle, private_handle, *fallback);
}

CalibrationServerNode::CalibrationServerNode(const NodeSetup& setup, const ros::NodeHandle& handle,
                                             const ros::NodeHandle& private_handle,
                                             const std::optional<EarlierCalibration>& fallback)
    : setup_(setup),
      output_path_(ReadText(private_handle, "output", "")),
      fallback_(fallback),
      handle_(handle),
      frame_parents_(handle),
      updater_(handle, private_handle),
      services_(private_handle) {
  ros::NodeHandle own = private_handle;
  calibration_publisher_ = own.advertise<Calibration>("calibration", 1, true);
  status_publisher_ = own.advertise<CalibrationStatus>("status", 1, true);
  coloured_cloud_publisher_ = own.advertise<sensor_msgs::PointCloud2>("coloured_cloud", 1, true);
  bundles_before_publisher_ = own.advertise<visualization_msgs::Marker>("bundles_before", 1, true);
  bundles_after_publisher_ = own.advertise<visualization_msgs::Marker>("bundles_after", 1, true);
  frusta_publisher_ = own.advertise<visualization_msgs::MarkerArray>("frusta", 1, true);
  for (const CameraConfig& camera : setup.rig.cameras) {
    for (const char* when : {"before", "after"}) {
      const std::string topic = "overlay/" + camera.name + "/" + when;
      overlay_publishers_[topic] = own.advertise<sensor_msgs::Image>(topic, 1, true);
    }
  }
  frusta_publisher_.publish(FrustumMarkers(setup.rig, kFrustumDepth_m));
  PublishStatus(CalibrationStatus::IDLE, "", 0.0, "waiting for recalibrate");

  updater_.setHardwareID("scenecalib");
  updater_.add("calibration", this, &CalibrationServerNode::Diagnose);
  diagnostics_timer_ = handle_.createWallTimer(
      ros::WallDuration(1.0), [this](const ros::WallTimerEvent&) { updater_.update(); });
  ros::NodeHandle& services = services_.handle;
  servers_ = {
      services.advertiseService("recalibrate", &CalibrationServerNode::HandleRecalibrate, this),
      services.advertiseService("cancel", &CalibrationServerNode::HandleCancel, this),
      services.advertiseService("save", &CalibrationServerNode::HandleSave, this),
      services.advertiseService("get", &CalibrationServerNode::HandleGet, this),
      services.advertiseService("reset", &CalibrationServerNode::HandleReset, this)};
  services_.Start();
}

CalibrationServerNode::~CalibrationServerNode() {
  cancel_ = true;
  diagnostics_timer_.stop();
  services_.Stop();
}

bool CalibrationServerNode::HandleRecalibrate(RecalibrateRequest& /*request*/,
                                              RecalibrateResponse& response) {
  if (running_.exchange(true)) {
    response.verdict = "busy";
    response.message = "a calibration is already running";
    return true;
  }
  cancel_ = false;
  Status status;
  try {
    status = Recalibrate(&response);
  } catch (const std::exception& error) {  // no input may end the node
    status = Status::Unavailable(std::string("calibration failed: ") + error.what());
  }
  if (!status.ok()) {
    response.verdict = status.code() == Status::Code::kCancelled ? "cancelled" : "failed";
    response.message = status.message() + StaysInForce(Earlier());
    PublishStatus(CalibrationStatus::FAILED, "", 0.0, response.message);
    ROS_ERROR_STREAM("recalibrate: " << response.message);
  }
  running_ = false;
  return true;
}

bool CalibrationServerNode::HandleCancel(std_srvs::TriggerRequest& /*request*/,
                                         std_srvs::TriggerResponse& response) {
  response.success = running_;
  response.message = running_ ? "the calibration is being stopped" : "no calibration is running";
  if (!running_) return true;
  cancel_ = true;
  std_srvs::Trigger cancel_map;
  const Status status = CallService(&handle_, "lidar_mapping/cancel", &cancel_map);
  if (!status.ok()) ROS_WARN_STREAM("cancel: " << status.message());
  return true;
}

bool CalibrationServerNode::HandleSave(SaveRequest& request, SaveResponse& response) {
  const std::string path = request.path.empty() ? output_path_ : request.path;
  const std::lock_guard<std::mutex> lock(mutex_);
  Status status;
  if (!last_result_) {
    status = Status::NotFound("there is no calibration yet: call recalibrate");
  } else if (path.empty()) {
    status = Status::InvalidArgument("neither the request nor the parameter ~output names a file");
  } else {
    status = WriteCalibration(path, *last_result_);
  }
  response.success = status.ok();
  response.message = status.ok() ? "written to " + path : status.message();
  return true;
}

bool CalibrationServerNode::HandleGet(GetCalibrationRequest& /*request*/,
                                      GetCalibrationResponse& response) {
  const std::lock_guard<std::mutex> lock(mutex_);
  response.success = last_result_.has_value();
  response.message = response.success ? "" : "there is no calibration yet: call recalibrate";
  if (last_result_) response.result = ToMessage(*last_result_, FromRosTime(ros::Time::now()));
  return true;
}

bool CalibrationServerNode::HandleReset(std_srvs::TriggerRequest& /*request*/,
                                        std_srvs::TriggerResponse& response) {
  Status status;
  std_srvs::Trigger reset;
  status = CallService(&handle_, "lidar_mapping/reset", &reset);
  for (const CameraConfig& camera : setup_.rig.cameras) {
    if (!status.ok()) break;
    status = CallService(&handle_, SegmentService(camera.name, "reset"), &reset);
  }
  response.success = status.ok();
  response.message = status.ok() ? "the segment buffers are empty" : status.message();
  return true;
}

Status CalibrationServerNode::Recalibrate(RecalibrateResponse* response) {
  const Result<Inputs> inputs = CollectInputs();
  if (!inputs.ok()) return inputs.status();
  Result<RigCalibration> calibration =
      CalibrateSegments(inputs->rig, inputs->map, inputs->segments, inputs->refusals,
                        setup_.options.calibration, setup_.options.miscalibration,
                        [this](const Progress& progress) { return OnProgress(progress); });
  if (!calibration.ok()) return calibration.status();
  CalibrationResult& result = calibration->result;
  std::vector<bool> in_force = ApplyFallback(Earlier(), &result);
  for (std::size_t i = 0; i < in_force.size(); ++i) {
    in_force[i] = in_force[i] || result.cameras[i].accepted;
  }
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    last_result_ = result;
    TakeAccepted(result, &accepted_);
  }
  const std::string left_alone = PublishTransforms(result, in_force);
  Publish(*inputs, *calibration);
  Answer(result, left_alone, response);
  return Status::Ok();
}

std::vector<EarlierCalibration> CalibrationServerNode::Earlier() {
  const std::lock_guard<std::mutex> lock(mutex_);
  std::vector<EarlierCalibration> earlier;
  const bool any = std::any_of(accepted_.cameras.begin(), accepted_.cameras.end(),
                               [](const CameraQuality& camera) { return camera.accepted; });
  if (any) earlier.push_back({"the calibration accepted before", accepted_});
  if (fallback_) earlier.push_back(*fallback_);
  return earlier;
}

void CalibrationServerNode::Answer(const CalibrationResult& result, const std::string& note,
                                   RecalibrateResponse* response) {
  response->verdict = result.accepted ? "accepted" : "partly_accepted";
  for (std::size_t i = 0; i < result.cameras.size(); ++i) {
    response->message += result.rig.cameras[i].name +
                         (result.cameras[i].accepted ? ": accepted; " : ": not accepted");
    if (result.cameras[i].accepted) continue;
    for (const std::string& reason : result.cameras[i].reasons) response->message += ", " + reason;
    response->message += "; ";
  }
  response->message += note;
  response->result = ToMessage(result, FromRosTime(ros::Time::now()));
  PublishStatus(result.accepted ? CalibrationStatus::ACCEPTED : CalibrationStatus::PARTLY, "", 1.0,
                response->message);
  if (result.accepted) {
    ROS_INFO_STREAM("recalibrate: " << response->message);
  } else {
    ROS_WARN_STREAM("recalibrate: " << response->message);
  }
}

Result<CalibrationServerNode::Inputs> CalibrationServerNode::CollectInputs() {
  Inputs inputs;
  inputs.rig = setup_.rig;
  inputs.segments.resize(setup_.rig.cameras.size());
  inputs.refusals.resize(setup_.rig.cameras.size());
  if (!OnProgress({"mapping", 0.0, ""})) return Status::Cancelled("cancelled");
  SCENECALIB_RETURN_IF_ERROR(CollectMap(&inputs));
  for (std::size_t i = 0; i < inputs.rig.cameras.size(); ++i) {
    const double fraction = static_cast<double>(i) / static_cast<double>(inputs.segments.size());
    if (!OnProgress({"collecting tracks", fraction, inputs.rig.cameras[i].name})) {
      return Status::Cancelled("cancelled");
    }
    SCENECALIB_RETURN_IF_ERROR(CollectSegment(i, &inputs));
  }
  return Result<Inputs>(std::move(inputs));
}

Status CalibrationServerNode::CollectMap(Inputs* inputs) {
  BuildMap service;
  SCENECALIB_RETURN_IF_ERROR(CallService(&handle_, "lidar_mapping/build_map", &service));
  if (!service.response.success) {
    const std::string message = "mapping: " + service.response.message;
    return cancel_ ? Status::Cancelled(message) : Status::InsufficientData(message);
  }
  for (const std::string& warning : service.response.warnings) ROS_WARN_STREAM(warning);
  Result<SceneMap> map = FromMessage(service.response.map);
  if (!map.ok()) return map.status();
  MappingReport report;
  report.path_length_m = service.response.path_length_m;
  report.thickness_after_m = service.response.surface_thickness_m;
  SCENECALIB_RETURN_IF_ERROR(CheckMapFitness(report, setup_.options.fitness));
  inputs->map = std::move(map).value();
  inputs->map_frame_id = service.response.map.header.frame_id;
  return Status::Ok();
}

Status CalibrationServerNode::CollectSegment(std::size_t camera, Inputs* inputs) {
  CameraConfig& config = inputs->rig.cameras[camera];
  GetSegment service;
  SCENECALIB_RETURN_IF_ERROR(
      CallService(&handle_, SegmentService(config.name, "get_segment"), &service));
  if (service.response.has_camera_info) {
    const Result<CameraModelPtr> model = CameraModelFromInfo(service.response.camera_info);
    if (!model.ok()) return model.status();
    config.model = *model;
  }
  if (!service.response.success || !config.model) {
    return Status::InsufficientData("camera " + config.name + ": " + service.response.message);
  }
  for (const std::string& warning : service.response.warnings) ROS_WARN_STREAM(warning);
  Result<CameraSegment> segment = FromMessage(service.response);
  if (!segment.ok()) return segment.status();
  inputs->segments[camera] = std::move(segment).value();
  if (!inputs->segments[camera].images.empty()) {
    inputs->refusals[camera] =
        WhyUnfit(MeasureFitness(inputs->segments[camera]), setup_.options.fitness);
  }
  return Status::Ok();
}

bool CalibrationServerNode::OnProgress(const Progress& progress) {
  PublishStatus(CalibrationStatus::RUNNING, progress.stage, progress.fraction, progress.detail);
  return !cancel_;
}

void CalibrationServerNode::Publish(const Inputs& inputs, const RigCalibration& calibration) {
  calibration_publisher_.publish(ToMessage(calibration.result, FromRosTime(ros::Time::now())));
  PublishPictures(inputs, calibration);
}

void CalibrationServerNode::PublishPictures(const Inputs& inputs,
                                            const RigCalibration& calibration) {
  const Rig& rig = calibration.result.rig;
  frusta_publisher_.publish(FrustumMarkers(rig, kFrustumDepth_m));
  bundles_before_publisher_.publish(
      BundleMarker(calibration.bundles_before, 0.9, 0.2, 0.1, inputs.map_frame_id));
  bundles_after_publisher_.publish(
      BundleMarker(calibration.bundles_after, 0.1, 0.8, 0.2, inputs.map_frame_id));
  coloured_cloud_publisher_.publish(ColouredCloud(
      inputs.map.points,
      ColourMap(rig, inputs.map, inputs.segments, NumImagesForColour(inputs.map.map_from_lidar)),
      inputs.map_frame_id));
  const Result<std::vector<CameraOverlays>> overlays =
      DrawOverlays(inputs.rig, rig, inputs.map, inputs.segments, kImagesPerOverlay);
  if (!overlays.ok()) {
    ROS_WARN_STREAM("overlays: " << overlays.status().message());
    return;
  }
  std_msgs::Header header;
  header.stamp = ros::Time::now();
  for (const CameraOverlays& camera : *overlays) {
    for (const bool is_after : {false, true}) {
      const std::string topic = "overlay/" + camera.camera + (is_after ? "/after" : "/before");
      overlay_publishers_.at(topic).publish(
          cv_bridge::CvImage(header, sensor_msgs::image_encodings::BGR8,
                             is_after ? camera.after : camera.before)
              .toImageMsg());
    }
  }
}

std::string CalibrationServerNode::PublishTransforms(const CalibrationResult& result,
                                                     const std::vector<bool>& in_force) {
  std::string left_alone;
  std::vector<geometry_msgs::TransformStamped> transforms;
  for (std::size_t i = 0; i < result.cameras.size(); ++i) {
    const CameraConfig& camera = result.rig.cameras[i];
    if (!in_force[i]) continue;
    const std::optional<std::string> parent = frame_parents_.ParentFromOthers(camera.frame_id);
    if (parent) {
      left_alone += "tf of " + camera.frame_id + " is not published: it already has the parent " +
                    *parent + "; ";
      continue;
    }
    geometry_msgs::TransformStamped transform;
    transform.header.stamp = ros::Time::now();
    transform.header.frame_id = result.rig.lidar.frame_id;
    transform.child_frame_id = camera.frame_id;
    transform.transform = ToTransformMessage(camera.lidar_from_camera);
    transforms.push_back(transform);
  }
  if (!transforms.empty()) broadcaster_.sendTransform(transforms);
  if (!left_alone.empty()) ROS_WARN_STREAM(left_alone);
  return left_alone;
}

void CalibrationServerNode::PublishStatus(std::uint8_t state, const std::string& stage,
                                          double fraction, const std::string& message) {
  const std::lock_guard<std::mutex> lock(mutex_);
  status_.header.stamp = ros::Time::now();
  status_.state = state;
  status_.stage = stage;
  status_.fraction = fraction;
  status_.message = message;
  status_publisher_.publish(status_);
}

void CalibrationServerNode::Diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
  const std::lock_guard<std::mutex> lock(mutex_);
  switch (status_.state) {
    case CalibrationStatus::PARTLY:
      status.summary(diagnostic_msgs::DiagnosticStatus::WARN,
                     "not every camera is calibrated: " + status_.message);
      break;
    case CalibrationStatus::FAILED:
      status.summary(diagnostic_msgs::DiagnosticStatus::ERROR,
                     "the last calibration failed: " + status_.message);
      break;
    case CalibrationStatus::RUNNING:
      status.summary(diagnostic_msgs::DiagnosticStatus::OK, "calibrating: " + status_.stage);
      break;
    case CalibrationStatus::ACCEPTED:
      status.summary(diagnostic_msgs::DiagnosticStatus::OK, "calibrated");
      break;
    default:
      status.summary(diagnostic_msgs::DiagnosticStatus::OK, "idle");
      break;
  }
  status.add("message", status_.message);
  status.add("fraction", status_.fraction);
}

}  // namespace scenecalib
