#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/sensor/image_pose.h"
#include "scenecalib/tracking/patch_registration.h"

namespace scenecalib {

/// A locally planar surface in the map frame.
struct MapPlane {
  Eigen::Vector3d point_in_map_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal_in_map = Eigen::Vector3d::UnitZ();  ///< unit, either side
};

/// An image as a camera took it; both outlive this.
struct PosedView {
  const CameraModel* model;
  const ImagePose* pose;
};

/// Where the ray through a pixel meets the plane, map frame; none when it points away or is flatter
/// on it than `min_grazing_sine`.
std::optional<Eigen::Vector3d> MeetPlane(const PosedView& view, const MapPlane& plane,
                                         const Eigen::Vector2d& pixel, double min_grazing_sine);

/// Points of the plane that a view sees at a pixel, first, and on a square around it.
using PlaneSamples = std::array<Eigen::Vector3d, 9>;
std::optional<PlaneSamples> SamplePlane(const PosedView& view, const MapPlane& plane,
                                        const Eigen::Vector2d& pixel, double half_edge_px,
                                        double min_grazing_sine);

/// How what one view sees at a pixel and around it appears in another one (Eq. 4 through the real
/// camera models), to second order, fitted to the samples; `half_edge_px` is their square's. None
/// when a sample leaves the image.
std::optional<PatchWarp> WarpInto(const PosedView& view, const PlaneSamples& samples,
                                  double half_edge_px);

}  // namespace scenecalib
