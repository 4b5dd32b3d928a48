#include "scenecalib/ros/result_display.h"

#include <cv_bridge/cv_bridge.h>
#include <ros/ros.h>
#include <scenecalib/Calibration.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>
#include <tf2_ros/static_transform_broadcaster.h>

#include <string>
#include <vector>

#include "scenecalib/pipeline/overlays.h"
#include "scenecalib/ros/message_conversion.h"
#include "scenecalib/ros/stage_messages.h"
#include "scenecalib/ros/visualization.h"

namespace scenecalib {
namespace {

constexpr char kMapFrame[] = "map";
constexpr int kImagesPerOverlay = 1;  // RViz shows them small
constexpr double kFrustumDepth_m = 1.0;

/// Keeps latched publishers alive.
class LatchedPublishers {
 public:
  template <typename Message>
  void Publish(const std::string& topic, const Message& message) {
    publishers_.push_back(handle_.advertise<Message>(topic, 1, true));
    publishers_.back().publish(message);
  }

 private:
  ros::NodeHandle handle_;
  std::vector<ros::Publisher> publishers_;
};

geometry_msgs::TransformStamped MakeTransform(const std::string& parent, const std::string& child,
                                              const Rigid3& parent_from_child) {
  geometry_msgs::TransformStamped transform;
  transform.header.stamp = ros::Time::now();
  transform.header.frame_id = parent;
  transform.child_frame_id = child;
  transform.transform = ToTransformMessage(parent_from_child);
  return transform;
}

void PublishOverlays(const PipelineResult& result, LatchedPublishers* publishers) {
  const Result<std::vector<CameraOverlays>> overlays =
      DrawOverlays(result.initial_rig, result.calibration.result.rig, result.mapping.map,
                   result.segments, kImagesPerOverlay);
  if (!overlays.ok()) return;
  for (const CameraOverlays& camera : *overlays) {
    for (const bool is_after : {false, true}) {
      publishers->Publish(
          "/calibration_server/overlay/" + camera.camera + (is_after ? "/after" : "/before"),
          *cv_bridge::CvImage(std_msgs::Header(), sensor_msgs::image_encodings::BGR8,
                              is_after ? camera.after : camera.before)
               .toImageMsg());
    }
  }
}

}  // namespace

void ShowResult(const PipelineResult& result) {
  ros::M_string no_remappings;
  ros::init(no_remappings, "calibrate_bag");
  const SceneMap& map = result.mapping.map;
  const Rig& rig = result.calibration.result.rig;
  LatchedPublishers publishers;
  publishers.Publish("/lidar_mapping/map", MapCloud(map.points, kMapFrame));
  publishers.Publish("/lidar_mapping/ground", GroundMarker(map.ground, kMapFrame));
  publishers.Publish("/lidar_mapping/surfels", SurfelMarker(map.surfels, kMapFrame));
  publishers.Publish("/lidar_mapping/trajectory", TrajectoryPath(map.map_from_lidar, kMapFrame));
  publishers.Publish("/calibration_server/frusta", FrustumMarkers(rig, kFrustumDepth_m));
  publishers.Publish("/calibration_server/bundles_before",
                     BundleMarker(result.calibration.bundles_before, 0.9, 0.2, 0.1, kMapFrame));
  publishers.Publish("/calibration_server/bundles_after",
                     BundleMarker(result.calibration.bundles_after, 0.1, 0.8, 0.2, kMapFrame));
  publishers.Publish(
      "/calibration_server/coloured_cloud",
      ColouredCloud(map.points,
                    ColourMap(rig, map, result.segments, NumImagesForColour(map.map_from_lidar)),
                    kMapFrame));
  publishers.Publish("/calibration_server/calibration",
                     ToMessage(result.calibration.result, FromRosTime(ros::Time::now())));
  PublishOverlays(result, &publishers);

  std::vector<geometry_msgs::TransformStamped> transforms = {MakeTransform(
      kMapFrame, rig.lidar.frame_id, map.map_from_lidar.poses().back().map_from_lidar)};
  for (const CameraConfig& camera : rig.cameras) {
    transforms.push_back(
        MakeTransform(rig.lidar.frame_id, camera.frame_id, camera.lidar_from_camera));
  }
  tf2_ros::StaticTransformBroadcaster broadcaster;
  broadcaster.sendTransform(transforms);
  ros::spin();
}

}  // namespace scenecalib
