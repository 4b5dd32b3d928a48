#pragma once

#include <nav_msgs/Path.h>
#include <sensor_msgs/PointCloud2.h>
#include <visualization_msgs/Marker.h>
#include <visualization_msgs/MarkerArray.h>

#include <cstdint>
#include <string>
#include <vector>

#include "scenecalib/calibration/rig_calibrator.h"
#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

// Pictures for RViz. Everything but the frusta is in the map frame.

nav_msgs::Path TrajectoryPath(const Trajectory& map_from_lidar, const std::string& map_frame_id);
/// x, y, z, intensity.
sensor_msgs::PointCloud2 MapCloud(const std::vector<MapPoint>& points,
                                  const std::string& map_frame_id);
/// x, y, z, rgb of the points whose colour, 0xRRGGBB, is known (negative: not seen).
sensor_msgs::PointCloud2 ColouredCloud(const std::vector<MapPoint>& points,
                                       const std::vector<int>& colours,
                                       const std::string& map_frame_id);
visualization_msgs::Marker GroundMarker(const TriangleMesh& ground,
                                        const std::string& map_frame_id);
/// Discs as hexagons, coloured by their normal; occluders (not planar) are grey.
visualization_msgs::Marker SurfelMarker(const std::vector<Surfel>& surfels,
                                        const std::string& map_frame_id);
/// From each ray's origin to its plane; `red`, `green`, `blue` in [0, 1].
visualization_msgs::Marker BundleMarker(const std::vector<RayBundle>& bundles, double red,
                                        double green, double blue, const std::string& map_frame_id);
/// Each camera's view out to `depth_m`, in the lidar frame; fisheyes as far as they see forward.
visualization_msgs::MarkerArray FrustumMarkers(const Rig& rig, double depth_m);

}  // namespace scenecalib
