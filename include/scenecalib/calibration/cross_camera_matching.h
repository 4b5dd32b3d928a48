#pragma once

#include <Eigen/Core>
#include <map>
#include <opencv2/core.hpp>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/base/timestamp.h"
#include "scenecalib/mapping/ray_caster.h"
#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/sensor/image_pose.h"

namespace scenecalib {

/// Correspondences between different cameras (III-E).
struct CrossCameraOptions {
  bool enabled = true;
  double radius_m = 0.5;
  int max_points_per_pair = 600;
  int max_views_per_point = 2;
  double max_scale = 2.0;
  int patch_px = 33;
  int search_px = 8;
  int search_again_px = 4;
  double min_ncc = 0.75;
  double max_peak_width_px = 8.0;
  double min_second_peak_gap = 0.05;
  double min_plane_share = 0.3;
  int register_radius_px = 12;
  double min_register_ncc = 0.85;
  double max_register_shift_px = 1.0;
  double max_sigma_px = 0.3;
  double sigma_floor_px = 0.03;
  double noise_correlation = 4.0;
  void Visit(OptionVisitor& v) {
    v.Field("enabled", &enabled, "match patches between cameras and use them in the joint solve");
    v.Field("radius_m", &radius_m, {0.01, 10.0},
            "feature points of two cameras this near each other make both cameras' views "
            "candidates");
    v.Field("max_points_per_pair", &max_points_per_pair, {0, 1000000},
            "feature points tried for each ordered pair of cameras");
    v.Field("max_views_per_point", &max_views_per_point, {1, 100},
            "views of the other camera tried for a point");
    v.Field("max_scale", &max_scale, {1.05, 10.0},
            "largest change of scale, in any direction, between the two views");
    v.Field("patch_px", &patch_px, {9, 257}, "edge of the patch that is correlated");
    v.Field("search_px", &search_px, {1, 100},
            "how far the correlation looks from where the calibrations predict the match");
    v.Field("search_again_px", &search_again_px, {1, 100},
            "the same once a joint solve has used the first matches");
    v.Field("min_ncc", &min_ncc, {-1.0, 1.0}, "least normalised cross-correlation of a match");
    v.Field("max_peak_width_px", &max_peak_width_px, {0.5, 50.0},
            "widest correlation peak, at half of its height over the window's mean");
    v.Field("min_second_peak_gap", &min_second_peak_gap, {0.0, 1.0},
            "by how much the correlation must beat any other peak in the window");
    v.Field("min_plane_share", &min_plane_share, {0.0, 1.0},
            "least share of the patch that lies on the point's plane");
    v.Field("register_radius_px", &register_radius_px, {3, 60},
            "half edge of the patch of the final registration");
    v.Field("min_register_ncc", &min_register_ncc, {-1.0, 1.0},
            "least correlation after the final registration");
    v.Field("max_register_shift_px", &max_register_shift_px, {0.05, 20.0},
            "how far the final registration may move from the correlation's peak");
    v.Field("max_sigma_px", &max_sigma_px, {0.01, 10.0}, "less certain matches are dropped");
    v.Field("sigma_floor_px", &sigma_floor_px, {0.0, 1.0},
            "error that the residual does not show, added to the covariance");
    v.Field("noise_correlation", &noise_correlation, {1.0, 100.0},
            "by how much neighbouring residuals' correlation inflates the covariance");
  }
};

/// A feature point of one camera: what a track sees, on its plane, and its reference view.
struct FeaturePoint {
  Eigen::Vector3d point_in_map_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal_in_map = Eigen::Vector3d::UnitZ();
  Timestamp reference_stamp_ns = 0;  ///< camera clock
  Eigen::Vector2d reference_px = Eigen::Vector2d::Zero();
  std::vector<Timestamp> stamps_ns;  ///< of all views of the track
};

/// A camera as the matching sees it, at the present calibration.
struct MatchingCamera {
  CameraModelPtr model;                                  ///< with the present intrinsics
  const std::map<Timestamp, cv::Mat>* images = nullptr;  ///< 8-bit grey, not owned
  std::map<Timestamp, ImagePose> poses;                  ///< of the images, by their stamps
  std::vector<FeaturePoint> points;
  /// Of the images, against their neighbours in time (RelativeSharpness); where it is missing an
  /// image passes for sharp.
  std::map<Timestamp, double> relative_sharpness;
};

/// One correspondence: the reference pixel of a feature point of the source camera is seen at
/// `pixel` by the target camera.
struct CrossCameraMatch {
  int source_camera = 0;
  int source_point = 0;  ///< index into MatchingCamera::points of the source
  int target_camera = 0;
  Timestamp target_stamp_ns = 0;  ///< camera clock
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Identity();
  Eigen::Vector2d predicted_px = Eigen::Vector2d::Zero();  ///< by map and calibration alone
  /// Centre of mass of the correlation, before the final registration (the paper's match).
  Eigen::Vector2d correlation_px = Eigen::Vector2d::Zero();
  double ncc = 0.0;
  double peak_width_px = 0.0;
};

/// What became of the candidates.
struct CrossCameraMatching {
  std::vector<CrossCameraMatch> matches;  ///< by source camera, target camera, point
  int num_candidates = 0;                 ///< views in which a point should be seen
  int num_occluded = 0;                   ///< the map says that something is in between
  int num_off_plane = 0;                  ///< too little of the patch is on the plane
  int num_unlike = 0;        ///< correlation too low or its peak at the window's border
  int num_wide = 0;          ///< wide or ambiguous peak
  int num_unregistered = 0;  ///< the final registration disagreed
};

/// Finds pixels of one camera's feature points in the other cameras' images, at whatever time those
/// saw the place: no simultaneous overlap is needed. Candidates come from a radius search between
/// the cameras' feature points; the surroundings in the source's reference view are warped through
/// plane and camera models into the target view (Eq. 4), histogram-equalised and correlated;
/// the peak is taken to sub-pixel by the centre of mass.
///
/// Differs from the paper: pixels whose rays do not meet the same plane do not count; the peak is
/// registered once more with shift, gain and bias, which gives a covariance and is more exact
/// (docs/accuracy.md).
///
/// Parallel; the result does not depend on the number of threads.
CrossCameraMatching MatchAcrossCameras(const std::vector<MatchingCamera>& cameras,
                                       const RayCaster& caster, const CrossCameraOptions& options);

}  // namespace scenecalib
