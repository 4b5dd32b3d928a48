#include "scenecalib/pipeline/report.h"

#include <tbb/parallel_invoke.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace scenecalib {
namespace {

constexpr int kPictureWidth_px = 900;
constexpr int kImagesShown = 2;  // of those one below the other in an overlay
constexpr int kJpegQuality = 82;
constexpr int kImagesPerCameraForColour = 8;

template <typename... Args>
std::string Format(const char* format, Args... args) {
  char text[512];
  std::snprintf(text, sizeof(text), format, args...);
  return text;
}

Result<std::vector<unsigned char>> Jpeg(const cv::Mat& image) {
  std::vector<unsigned char> bytes;
  if (!cv::imencode(".jpg", image, bytes, {cv::IMWRITE_JPEG_QUALITY, kJpegQuality})) {
    return Status::Unavailable("report: a picture cannot be encoded as JPEG");
  }
  return bytes;
}

/// The first images of an overlay, at most as wide as a page needs.
cv::Mat Reduced(const cv::Mat& overlay, int image_height_px) {
  const int rows = std::min(overlay.rows, kImagesShown * image_height_px);
  const cv::Mat top = overlay.rowRange(0, rows);
  if (top.cols <= kPictureWidth_px) return top;
  cv::Mat reduced;
  const double scale = static_cast<double>(kPictureWidth_px) / top.cols;
  cv::resize(top, reduced, cv::Size(), scale, scale, cv::INTER_AREA);
  return reduced;
}

/// Where to look at the cloud from: above a place of the drive, where no wall can be, along the
/// drive's middle part.
Rigid3 ViewOf(const Trajectory& map_from_lidar) {
  constexpr double kBack_m = 14.0;
  constexpr double kUp_m = 5.0;
  constexpr double kDown_rad = 0.3;
  const std::vector<TimedPose>& poses = map_from_lidar.poses();
  const Eigen::Vector3d middle = poses[poses.size() / 2].map_from_lidar.translation;
  std::size_t from = poses.size() / 2;
  const auto to_middle = [&](std::size_t i) {
    return Eigen::Vector3d(middle - poses[i].map_from_lidar.translation);
  };
  while (from > 0 && to_middle(from).norm() < kBack_m) --from;
  Eigen::Vector3d along = to_middle(from);
  along.z() = 0.0;
  along = along.norm() > 1e-3 ? along.normalized() : Eigen::Vector3d::UnitX();
  const Eigen::Vector3d forward =
      std::cos(kDown_rad) * along - std::sin(kDown_rad) * Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d right = forward.cross(Eigen::Vector3d::UnitZ()).normalized();
  Eigen::Matrix3d rotation;
  rotation << right, forward.cross(right), forward;
  return Rigid3(Eigen::Quaterniond(rotation),
                poses[from].map_from_lidar.translation + kUp_m * Eigen::Vector3d::UnitZ());
}

/// When the lidar passed what the view shows: images of elsewhere do not see its ground.
ImageWindow TimeNear(const Rigid3& map_from_view, const Trajectory& map_from_lidar) {
  constexpr double kNear_m = 45.0;
  const std::vector<TimedPose>& poses = map_from_lidar.poses();
  const auto is_near = [&](std::size_t i) {
    return (poses[i].map_from_lidar.translation - map_from_view.translation).norm() < kNear_m;
  };
  std::size_t first = poses.size() / 2;
  std::size_t last = first;
  while (first > 0 && is_near(first - 1)) --first;
  while (last + 1 < poses.size() && is_near(last + 1)) ++last;
  return {poses[first].stamp_ns, poses[last].stamp_ns};
}

/// Coloured points as squares, the nearest on top.
cv::Mat DrawCloud(const std::vector<MapPoint>& points, const std::vector<int>& colours,
                  const Rigid3& map_from_view) {
  constexpr int kHeight_px = 560;
  constexpr double kFocal_px = 620.0;
  constexpr double kPointEdge_m = 0.14;
  cv::Mat canvas(kHeight_px, kPictureWidth_px, CV_8UC3, cv::Scalar(250, 248, 246));
  cv::Mat depth_m(canvas.size(), CV_32FC1, cv::Scalar(std::numeric_limits<float>::max()));
  const Rigid3 view_from_map = map_from_view.Inverse();
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (colours[i] < 0) continue;
    const Eigen::Vector3d p = view_from_map * points[i].position_m.cast<double>();
    if (p.z() < 2.0) continue;
    const int x = static_cast<int>(0.5 * kPictureWidth_px + kFocal_px * p.x() / p.z());
    const int y = static_cast<int>(0.5 * kHeight_px + kFocal_px * p.y() / p.z());
    const int half = std::max(1, static_cast<int>(0.5 * kPointEdge_m * kFocal_px / p.z()));
    const cv::Rect square =
        cv::Rect(x - half, y - half, 2 * half, 2 * half) & cv::Rect(cv::Point(), canvas.size());
    const cv::Vec3b bgr(static_cast<unsigned char>(colours[i] & 255),
                        static_cast<unsigned char>(colours[i] >> 8 & 255),
                        static_cast<unsigned char>(colours[i] >> 16 & 255));
    for (int row = square.y; row < square.y + square.height; ++row) {
      for (int column = square.x; column < square.x + square.width; ++column) {
        float& nearest = depth_m.at<float>(row, column);
        if (static_cast<float>(p.z()) >= nearest) continue;
        nearest = static_cast<float>(p.z());
        canvas.at<cv::Vec3b>(row, column) = bgr;
      }
    }
  }
  return canvas;
}

Result<ReportPicture> Encode(const std::string& caption, const cv::Mat& before,
                             const cv::Mat& after) {
  const auto before_jpeg = Jpeg(before);
  if (!before_jpeg.ok()) return before_jpeg.status();
  const auto after_jpeg = Jpeg(after);
  if (!after_jpeg.ok()) return after_jpeg.status();
  return ReportPicture{caption, *before_jpeg, *after_jpeg};
}

std::vector<std::string> Facts(const PipelineResult& result) {
  const MappingReport& mapping = result.mapping.report;
  return {
      Format("%d of %d scans used, %.1f m travelled, IMU %s, odometry %s.", mapping.num_scans_used,
             mapping.num_scans_in, mapping.path_length_m, mapping.used_imu ? "used" : "not used",
             mapping.used_odometry ? "used" : "not used"),
      DescribeLasers(mapping) + ".",
      Format("%zu surfels, %zu ground triangles; %d points of moving objects were removed.",
             result.mapping.map.surfels.size(), result.mapping.map.ground.triangles.size(),
             mapping.num_points_moving)};
}

}  // namespace

std::string DescribeLasers(const MappingReport& report) {
  constexpr double kDegrees = 180.0 / M_PI;
  if (report.laser_range_m < 5e-5 && kDegrees * report.laser_elevation_rad < 5e-4) {
    return "lasers: as the lidar reports them";
  }
  return Format("lasers: corrected by %.1f mm and %.3f deg in elevation (RMS)",
                1e3 * report.laser_range_m, kDegrees * report.laser_elevation_rad);
}

Result<ReportData> MakeReportData(const PipelineResult& result,
                                  const std::vector<CameraOverlays>& overlays) {
  ReportData data;
  data.initial = result.initial_rig;
  data.result = result.calibration.result;
  data.evidence = result.calibration.evidence;
  data.map_from_lidar = result.mapping.map.map_from_lidar;
  data.facts = Facts(result);
  for (const StageCost& cost : result.costs) {
    data.stages.push_back({cost.stage, cost.wall_s, cost.peak_memory_mib});
  }
  for (const CameraSegment& segment : result.segments) {
    data.warnings.insert(data.warnings.end(), segment.warnings.begin(), segment.warnings.end());
  }
  const std::vector<std::string>& of_map = result.mapping.report.warnings;
  data.warnings.insert(data.warnings.end(), of_map.begin(), of_map.end());
  data.warnings.insert(data.warnings.end(), result.warnings.begin(), result.warnings.end());
  for (const CameraOverlays& camera : overlays) {
    int height_px = camera.before.rows;
    for (const CameraConfig& config : data.initial.cameras) {
      if (config.name == camera.camera) height_px = config.model->height_px();
    }
    const auto picture =
        Encode(camera.camera, Reduced(camera.before, height_px), Reduced(camera.after, height_px));
    if (!picture.ok()) return picture.status();
    data.overlays.push_back(*picture);
  }
  const SceneMap& map = result.mapping.map;
  if (map.map_from_lidar.empty() || map.points.empty()) return data;
  const Rigid3 view = ViewOf(map.map_from_lidar);
  const auto cloud = [&](const Rig& rig) {
    return DrawCloud(map.points,
                     ColourMap(rig, map, result.segments, kImagesPerCameraForColour,
                               TimeNear(view, map.map_from_lidar)),
                     view);
  };
  cv::Mat before, after;
  tbb::parallel_invoke([&] { before = cloud(data.initial); },
                       [&] { after = cloud(data.result.rig); });
  const auto picture = Encode("all cameras", before, after);
  if (!picture.ok()) return picture.status();
  data.clouds.push_back(*picture);
  return data;
}

}  // namespace scenecalib
