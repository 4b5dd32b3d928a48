#include "scenecalib/ros/visualization.h"

#include <geometry_msgs/Point.h>
#include <sensor_msgs/point_cloud2_iterator.h>
#include <std_msgs/ColorRGBA.h>

#include <array>
#include <cmath>
#include <optional>

#include "scenecalib/ros/message_conversion.h"

namespace scenecalib {
namespace {

geometry_msgs::Point ToPoint(const Eigen::Vector3d& v) {
  geometry_msgs::Point point;
  point.x = v.x();
  point.y = v.y();
  point.z = v.z();
  return point;
}

std_msgs::ColorRGBA ToColor(double red, double green, double blue, double alpha) {
  std_msgs::ColorRGBA color;
  color.r = static_cast<float>(red);
  color.g = static_cast<float>(green);
  color.b = static_cast<float>(blue);
  color.a = static_cast<float>(alpha);
  return color;
}

visualization_msgs::Marker MakeMarker(const std::string& frame_id, const std::string& name,
                                      int type) {
  visualization_msgs::Marker marker;
  marker.header.frame_id = frame_id;
  marker.ns = name;
  marker.type = type;
  marker.action = visualization_msgs::Marker::ADD;
  marker.pose.orientation.w = 1.0;
  marker.scale.x = marker.scale.y = marker.scale.z = 1.0;
  marker.color = ToColor(1.0, 1.0, 1.0, 1.0);
  return marker;
}

void PrepareCloud(const std::string& frame_id, sensor_msgs::PointCloud2* cloud) {
  cloud->header.frame_id = frame_id;
  cloud->height = 1;
  cloud->is_dense = 1;
}

/// RViz drops a marker of triangles whose list is empty or not a multiple of three.
bool HasTriangles(const visualization_msgs::Marker& marker) { return marker.points.size() >= 3; }

}  // namespace

nav_msgs::Path TrajectoryPath(const Trajectory& map_from_lidar, const std::string& map_frame_id) {
  nav_msgs::Path path;
  path.header.frame_id = map_frame_id;
  for (const TimedPose& timed : map_from_lidar.poses()) {
    geometry_msgs::PoseStamped pose;
    pose.header.frame_id = map_frame_id;
    pose.header.stamp = ToRosTime(timed.stamp_ns);
    pose.pose = ToPoseMessage(timed.map_from_lidar);
    path.poses.push_back(pose);
  }
  return path;
}

sensor_msgs::PointCloud2 MapCloud(const std::vector<MapPoint>& points,
                                  const std::string& map_frame_id) {
  sensor_msgs::PointCloud2 cloud;
  PrepareCloud(map_frame_id, &cloud);
  sensor_msgs::PointCloud2Modifier modifier(cloud);
  modifier.setPointCloud2Fields(
      4, "x", 1, sensor_msgs::PointField::FLOAT32, "y", 1, sensor_msgs::PointField::FLOAT32, "z", 1,
      sensor_msgs::PointField::FLOAT32, "intensity", 1, sensor_msgs::PointField::FLOAT32);
  modifier.resize(points.size());
  sensor_msgs::PointCloud2Iterator<float> at(cloud, "x");
  for (const MapPoint& point : points) {
    for (int i = 0; i < 3; ++i) at[i] = point.position_m[i];
    at[3] = point.intensity;
    ++at;
  }
  return cloud;
}

sensor_msgs::PointCloud2 ColouredCloud(const std::vector<MapPoint>& points,
                                       const std::vector<int>& colours,
                                       const std::string& map_frame_id) {
  std::size_t num_seen = 0;
  for (const int value : colours) num_seen += value >= 0 ? 1 : 0;
  sensor_msgs::PointCloud2 cloud;
  PrepareCloud(map_frame_id, &cloud);
  sensor_msgs::PointCloud2Modifier modifier(cloud);
  modifier.setPointCloud2FieldsByString(2, "xyz", "rgb");
  modifier.resize(num_seen);
  sensor_msgs::PointCloud2Iterator<float> at(cloud, "x");
  sensor_msgs::PointCloud2Iterator<std::uint8_t> color(cloud, "rgb");
  for (std::size_t i = 0; i < points.size() && i < colours.size(); ++i) {
    if (colours[i] < 0) continue;
    for (int axis = 0; axis < 3; ++axis) {
      at[axis] = points[i].position_m[axis];
      color[axis] = static_cast<std::uint8_t>(colours[i] >> (8 * axis));  // blue first
    }
    ++at;
    ++color;
  }
  return cloud;
}

visualization_msgs::Marker GroundMarker(const TriangleMesh& ground,
                                        const std::string& map_frame_id) {
  auto marker = MakeMarker(map_frame_id, "ground", visualization_msgs::Marker::TRIANGLE_LIST);
  marker.color = ToColor(0.45, 0.4, 0.35, 1.0);
  for (const std::array<int, 3>& triangle : ground.triangles) {
    for (const int vertex : triangle) {
      marker.points.push_back(
          ToPoint(ground.vertices_m[static_cast<std::size_t>(vertex)].cast<double>()));
    }
  }
  if (!HasTriangles(marker)) marker.action = visualization_msgs::Marker::DELETE;
  return marker;
}

visualization_msgs::Marker SurfelMarker(const std::vector<Surfel>& surfels,
                                        const std::string& map_frame_id) {
  auto marker = MakeMarker(map_frame_id, "surfels", visualization_msgs::Marker::TRIANGLE_LIST);
  for (const Surfel& surfel : surfels) {
    const Eigen::Vector3d normal = surfel.normal.cast<double>();
    const Eigen::Vector3d center = surfel.center_m.cast<double>();
    const Eigen::Vector3d u = normal.unitOrthogonal() * surfel.radius_m;
    const Eigen::Vector3d v = normal.cross(u);
    const std_msgs::ColorRGBA color =
        surfel.planar
            ? ToColor(0.5 + 0.5 * normal.x(), 0.5 + 0.5 * normal.y(), 0.5 + 0.5 * normal.z(), 1.0)
            : ToColor(0.4, 0.4, 0.4, 1.0);
    std::array<Eigen::Vector3d, 6> corners;
    for (std::size_t i = 0; i < corners.size(); ++i) {
      const double angle = M_PI / 3.0 * static_cast<double>(i);
      corners[i] = center + std::cos(angle) * u + std::sin(angle) * v;
    }
    for (std::size_t i = 1; i + 1 < corners.size(); ++i) {
      for (const Eigen::Vector3d& corner : {corners[0], corners[i], corners[i + 1]}) {
        marker.points.push_back(ToPoint(corner));
        marker.colors.push_back(color);
      }
    }
  }
  if (!HasTriangles(marker)) marker.action = visualization_msgs::Marker::DELETE;
  return marker;
}

visualization_msgs::Marker BundleMarker(const std::vector<RayBundle>& bundles, double red,
                                        double green, double blue,
                                        const std::string& map_frame_id) {
  auto marker = MakeMarker(map_frame_id, "bundles", visualization_msgs::Marker::LINE_LIST);
  marker.scale.x = 0.01;
  marker.color = ToColor(red, green, blue, 0.6);
  for (const RayBundle& bundle : bundles) {
    for (std::size_t i = 0; i < bundle.origins_in_map_m.size() && i < bundle.points_in_map_m.size();
         ++i) {
      marker.points.push_back(ToPoint(bundle.origins_in_map_m[i]));
      marker.points.push_back(ToPoint(bundle.points_in_map_m[i]));
    }
  }
  if (marker.points.empty()) marker.action = visualization_msgs::Marker::DELETE;
  return marker;
}

visualization_msgs::MarkerArray FrustumMarkers(const Rig& rig, double depth_m) {
  visualization_msgs::MarkerArray array;
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    const CameraConfig& camera = rig.cameras[i];
    if (!camera.model) continue;
    auto marker = MakeMarker(rig.lidar.frame_id, "frustum", visualization_msgs::Marker::LINE_LIST);
    marker.id = static_cast<int>(i);
    marker.scale.x = 0.02;
    marker.color = ToColor(1.0, 0.8, 0.1, 1.0);
    const double right = camera.model->width_px() - 1.0;
    const double bottom = camera.model->height_px() - 1.0;
    const Eigen::Vector2d middle(0.5 * right, 0.5 * bottom);
    const std::array<Eigen::Vector2d, 4> corners = {
        Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(right, 0.0), Eigen::Vector2d(right, bottom),
        Eigen::Vector2d(0.0, bottom)};
    const auto origin = ToPoint(camera.lidar_from_camera.translation);
    std::optional<geometry_msgs::Point> previous;
    constexpr int kSteps = 8;  // along each side of the image: a fisheye's frustum is curved
    for (int k = 0; k <= 4 * kSteps; ++k) {
      const auto side = static_cast<std::size_t>(k / kSteps) % 4;
      const double along = static_cast<double>(k % kSteps) / kSteps;
      const Eigen::Vector2d border =
          corners[side] + along * (corners[(side + 1) % 4] - corners[side]);
      // Beyond a fisheye's image circle there is no ray: come in towards the middle until there is.
      std::optional<Eigen::Vector3d> ray;
      for (double inward = 0.0; inward < 1.0 && !ray; inward += 0.05) {
        ray = camera.model->Unproject(border + inward * (middle - border));
      }
      if (!ray) continue;
      const auto tip = ToPoint(camera.lidar_from_camera * Eigen::Vector3d(depth_m * *ray));
      if (k % kSteps == 0) marker.points.insert(marker.points.end(), {origin, tip});
      if (previous) marker.points.insert(marker.points.end(), {*previous, tip});
      previous = tip;
    }
    array.markers.push_back(marker);
  }
  return array;
}

}  // namespace scenecalib
