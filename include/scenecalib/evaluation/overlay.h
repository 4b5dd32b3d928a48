#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/sensor/image_pose.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

struct OverlayOptions {
  double min_range_m = 2.0;
  double max_range_m = 80.0;
  int point_spacing_px = 4;
  double map_spacing_m = 0.2;
  double image_brightness = 0.8;
  void Visit(OptionVisitor& v) {
    v.Field("min_range_m", &min_range_m, {0.1, 100.0}, "nearest point drawn; the warm end");
    v.Field("max_range_m", &max_range_m, {1.0, 1000.0}, "farthest point drawn; the cold end");
    v.Field("point_spacing_px", &point_spacing_px, {1, 64},
            "at most one dot per square of this edge, so that the image stays visible between");
    v.Field("map_spacing_m", &map_spacing_m, {0.01, 2.0},
            "distance between points of a surface that still hides what lies behind");
    v.Field("image_brightness", &image_brightness, {0.0, 1.0}, "of the image behind the dots");
  }
};

/// The lidar's map over a camera's image: dots coloured by range (logarithmic, warm is near) with a
/// legend in metres and `caption` in the corner. A point behind a nearer surface is not drawn.
/// `image` is CV_8UC1 or CV_8UC3 (BGR) of the camera's size; `pose` is where the camera was
/// meanwhile (ImagePoseOf). The result is CV_8UC3 of the same size.
/// InvalidArgument for another size or type, or a camera without a model.
Result<cv::Mat> DrawOverlay(const cv::Mat& image, const CameraConfig& camera,
                            const std::vector<MapPoint>& points, const ImagePose& pose,
                            const std::string& caption, const OverlayOptions& options);

/// A map point that a camera sees.
struct VisiblePoint {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double range_m = 0.0;
  std::size_t index = 0;  ///< into the points given
};

/// The points inside the image, within [min_range_m, max_range_m], that no nearer surface hides, by
/// index. Surfaces are sampled by points only, so each point hides what lies well behind it over
/// map_spacing_m around it; the depth margin grows with range so that ground seen at a grazing
/// angle does not hide itself.
std::vector<VisiblePoint> FindVisiblePoints(const CameraModel& camera,
                                            const std::vector<MapPoint>& points,
                                            const ImagePose& pose, const OverlayOptions& options);

}  // namespace scenecalib
