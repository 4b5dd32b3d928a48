#include "scenecalib/evaluation/overlay.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "scenecalib/sensor/lens_shape.h"

namespace scenecalib {
namespace {

constexpr int kCellPx = 4;  // of the depth buffer
// Depth differences within a cell on ground seen from this height are not occlusions.
constexpr double kCameraHeightM = 1.5;
constexpr double kDepthMarginM = 0.5;
/// Outside the field of view by more than this nothing is seen, however the shutter rolls.
constexpr double kFieldMargin_rad = 0.1;

/// Smallest range per cell of kCellPx.
class DepthBuffer {
 public:
  DepthBuffer(int width_px, int height_px)
      : columns_(width_px / kCellPx + 1),
        rows_(height_px / kCellPx + 1),
        range_m_(static_cast<std::size_t>(columns_) * rows_, std::numeric_limits<float>::max()) {}

  void Splat(const Eigen::Vector2d& pixel, double radius_px, double range_m) {
    const int left = Cell(pixel.x() - radius_px, columns_);
    const int right = Cell(pixel.x() + radius_px, columns_);
    const int top = Cell(pixel.y() - radius_px, rows_);
    const int bottom = Cell(pixel.y() + radius_px, rows_);
    for (int row = top; row <= bottom; ++row) {
      for (int column = left; column <= right; ++column) {
        float& nearest = range_m_[static_cast<std::size_t>(row) * columns_ + column];
        nearest = std::min(nearest, static_cast<float>(range_m));
      }
    }
  }

  double At(const Eigen::Vector2d& pixel) const {
    return range_m_[static_cast<std::size_t>(Cell(pixel.y(), rows_)) * columns_ +
                    Cell(pixel.x(), columns_)];
  }

 private:
  static int Cell(double px, int count) {
    return std::min(std::max(static_cast<int>((px + 0.5) / kCellPx), 0), count - 1);
  }

  int columns_;
  int rows_;
  std::vector<float> range_m_;
};

/// 1 at the nearest range drawn, 0 at the farthest.
double Warmth(double range_m, const OverlayOptions& options) {
  const double t =
      std::log(range_m / options.min_range_m) / std::log(options.max_range_m / options.min_range_m);
  return 1.0 - std::min(std::max(t, 0.0), 1.0);
}

/// 256 BGR colours from cold to warm.
std::vector<cv::Vec3b> ColorTable() {
  cv::Mat ramp(1, 256, CV_8UC1);
  // The dark ends of the map would be lost on a dark image.
  for (int i = 0; i < 256; ++i)
    ramp.at<unsigned char>(0, i) = static_cast<unsigned char>(20 + i * 220 / 255);
  cv::Mat colors;
  cv::applyColorMap(ramp, colors, cv::COLORMAP_TURBO);
  return {colors.begin<cv::Vec3b>(), colors.end<cv::Vec3b>()};
}

cv::Vec3b Color(double range_m, const std::vector<cv::Vec3b>& table,
                const OverlayOptions& options) {
  return table[static_cast<std::size_t>(std::lround(255.0 * Warmth(range_m, options)))];
}

void PutText(const std::string& text, const cv::Point& origin, double scale, cv::Mat* canvas) {
  const int thickness = std::max(1, static_cast<int>(std::lround(1.6 * scale)));
  cv::putText(*canvas, text, origin, cv::FONT_HERSHEY_SIMPLEX, scale, cv::Scalar::all(0),
              thickness + 2, cv::LINE_AA);
  cv::putText(*canvas, text, origin, cv::FONT_HERSHEY_SIMPLEX, scale, cv::Scalar::all(255),
              thickness, cv::LINE_AA);
}

/// On a dark panel in the upper left corner: among dots nothing else can be read.
void DrawCaption(const std::string& caption, cv::Mat* canvas) {
  const double scale = std::max(0.8, canvas->rows / 750.0);
  const int margin = static_cast<int>(12 * scale);
  const int thickness = std::max(1, static_cast<int>(std::lround(1.6 * scale))) + 2;
  const cv::Size size =
      cv::getTextSize(caption, cv::FONT_HERSHEY_SIMPLEX, scale, thickness, nullptr);
  const cv::Rect panel = cv::Rect(0, 0, size.width + 2 * margin, size.height + 2 * margin) &
                         cv::Rect(0, 0, canvas->cols, canvas->rows);
  cv::Mat background = (*canvas)(panel);
  background.convertTo(background, -1, 0.25);
  PutText(caption, {margin, margin + size.height}, scale, canvas);
}

/// Ranges worth a tick: 1, 2 and 5 times the powers of ten.
std::vector<double> Ticks(const OverlayOptions& options) {
  std::vector<double> ticks;
  for (double decade = 0.1; decade <= options.max_range_m; decade *= 10.0) {
    for (const double factor : {1.0, 2.0, 5.0}) {
      const double range_m = decade * factor;
      if (range_m >= 0.999 * options.min_range_m && range_m <= 1.001 * options.max_range_m) {
        ticks.push_back(range_m);
      }
    }
  }
  return ticks;
}

/// A vertical colour bar at the right edge, far at the top as in the image.
void DrawLegend(const std::vector<cv::Vec3b>& table, const OverlayOptions& options,
                cv::Mat* canvas) {
  const double scale = canvas->rows / 1200.0;
  const int bar_height = canvas->rows / 2;
  const int bar_width = std::max(6, canvas->rows / 50);
  const int label_width = static_cast<int>(130 * scale) + 8;
  const int left = canvas->cols - bar_width - label_width;
  const int top = canvas->rows - bar_height - canvas->rows / 25;
  if (left < 0 || bar_height < 20) return;
  const cv::Rect panel = cv::Rect(left - bar_width / 2, top - bar_width, bar_width + label_width,
                                  bar_height + 2 * bar_width) &
                         cv::Rect(0, 0, canvas->cols, canvas->rows);
  cv::Mat background = (*canvas)(panel);
  background.convertTo(background, -1, 0.35);
  const double log_ratio = std::log(options.max_range_m / options.min_range_m);
  for (int y = 0; y < bar_height; ++y) {
    const double range_m =
        options.max_range_m * std::exp(-log_ratio * y / std::max(1, bar_height - 1));
    const cv::Vec3b color = Color(range_m, table, options);
    cv::line(*canvas, {left, top + y}, {left + bar_width, top + y},
             cv::Scalar(color[0], color[1], color[2]));
  }
  for (const double range_m : Ticks(options)) {
    const int y = top + static_cast<int>(std::lround((bar_height - 1) * Warmth(range_m, options)));
    cv::line(*canvas, {left + bar_width, y}, {left + bar_width + 3, y}, cv::Scalar::all(255));
    char label[32];
    std::snprintf(label, sizeof(label), "%g m", range_m);
    PutText(label, {left + bar_width + 6, y + static_cast<int>(10 * scale)}, scale, canvas);
  }
}

/// At most one dot per square, the nearest point's.
void DrawDots(const std::vector<VisiblePoint>& visible, const std::vector<cv::Vec3b>& table,
              const OverlayOptions& options, cv::Mat* canvas) {
  const int step = options.point_spacing_px;
  const int columns = canvas->cols / step + 1;
  std::vector<const VisiblePoint*> nearest(
      static_cast<std::size_t>(columns) * (canvas->rows / step + 1), nullptr);
  for (const VisiblePoint& point : visible) {
    const int column = static_cast<int>((point.pixel.x() + 0.5) / step);
    const int row = static_cast<int>((point.pixel.y() + 0.5) / step);
    const VisiblePoint*& kept = nearest[static_cast<std::size_t>(row) * columns + column];
    if (kept == nullptr || point.range_m < kept->range_m) kept = &point;
  }
  // Sub-pixel circles: a dot rounded to whole pixels would look misaligned by half a pixel.
  constexpr int kShift = 4;
  const double radius_px = std::max(0.9, 0.3 * step) * std::max(1.0, canvas->rows / 1200.0);
  for (const VisiblePoint* point : nearest) {
    if (point == nullptr) continue;
    const cv::Vec3b color = Color(point->range_m, table, options);
    const cv::Point center(static_cast<int>(std::lround(point->pixel.x() * (1 << kShift))),
                           static_cast<int>(std::lround(point->pixel.y() * (1 << kShift))));
    cv::circle(*canvas, center, static_cast<int>(radius_px * (1 << kShift)),
               cv::Scalar(color[0], color[1], color[2]), cv::FILLED, cv::LINE_AA, kShift);
  }
}

}  // namespace

std::vector<VisiblePoint> FindVisiblePoints(const CameraModel& camera,
                                            const std::vector<MapPoint>& points,
                                            const ImagePose& pose, const OverlayOptions& options) {
  const double px_per_rad = std::max(1.0, FocalAtAxisPx(camera));
  const double min_cosine = std::cos(std::min(M_PI, camera.max_theta_rad() + kFieldMargin_rad));
  const Rigid3 camera_from_map = pose.map_from_camera().Inverse();
  const Eigen::Matrix3d rotation = camera_from_map.RotationMatrix();
  DepthBuffer depth(camera.width_px(), camera.height_px());
  std::vector<VisiblePoint> inside;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d point_in_map = points[i].position_m.cast<double>();
    Eigen::Vector3d point_in_camera = rotation * point_in_map + camera_from_map.translation;
    const double range_m = point_in_camera.norm();
    if (!(range_m >= options.min_range_m && range_m <= options.max_range_m)) continue;
    if (point_in_camera.z() < min_cosine * range_m) continue;
    if (pose.is_rolling()) {
      const auto seen = pose.WhenSeen(camera, point_in_map);
      if (!seen) continue;
      point_in_camera = *seen;
    }
    const auto pixel = camera.Project(point_in_camera);
    if (!pixel) continue;
    depth.Splat(*pixel, 0.5 * options.map_spacing_m * px_per_rad / range_m, range_m);
    inside.push_back({*pixel, range_m, i});
  }
  std::vector<VisiblePoint> visible;
  for (const VisiblePoint& point : inside) {
    // A cell with the splat around it spans this angle; on flat ground that is range^2 / height
    // times as long in depth.
    const double span_rad = kCellPx / px_per_rad + 0.5 * options.map_spacing_m / point.range_m;
    const double margin_m =
        kDepthMarginM + span_rad * point.range_m * point.range_m / kCameraHeightM;
    if (point.range_m <= depth.At(point.pixel) + margin_m) visible.push_back(point);
  }
  return visible;
}

Result<cv::Mat> DrawOverlay(const cv::Mat& image, const CameraConfig& camera,
                            const std::vector<MapPoint>& points, const ImagePose& pose,
                            const std::string& caption, const OverlayOptions& options) {
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  if (options.max_range_m <= options.min_range_m) {
    return Status::InvalidArgument("overlay: max_range_m must be larger than min_range_m");
  }
  if (!camera.model) {
    return Status::InvalidArgument("overlay: camera " + camera.name + " has no intrinsics");
  }
  if (image.cols != camera.model->width_px() || image.rows != camera.model->height_px() ||
      (image.type() != CV_8UC1 && image.type() != CV_8UC3)) {
    return Status::InvalidArgument(
        "overlay: camera " + camera.name + " needs an 8-bit grey or BGR image of " +
        std::to_string(camera.model->width_px()) + "x" + std::to_string(camera.model->height_px()) +
        ", not one of " + std::to_string(image.cols) + "x" + std::to_string(image.rows));
  }
  cv::Mat canvas;
  if (image.channels() == 1) {
    cv::cvtColor(image, canvas, cv::COLOR_GRAY2BGR);
  } else {
    canvas = image.clone();
  }
  canvas.convertTo(canvas, -1, options.image_brightness);
  const std::vector<cv::Vec3b> table = ColorTable();
  DrawDots(FindVisiblePoints(*camera.model, points, pose, options), table, options, &canvas);
  DrawLegend(table, options, &canvas);
  if (!caption.empty()) {
    DrawCaption(caption, &canvas);
  }
  return canvas;
}

}  // namespace scenecalib
