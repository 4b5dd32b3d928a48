#include "scenecalib/pipeline/overlays.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "scenecalib/evaluation/overlay.h"
#include "scenecalib/sensor/image_pose.h"

namespace scenecalib {
namespace {

/// An image and where its camera was meanwhile, by the initial rig and by the calibrated one.
struct PlacedImage {
  cv::Mat pixels;
  ImagePose initial;
  ImagePose calibrated;
};

/// Up to max_images images inside the map's time and the window, in colour where there is any,
/// spread evenly; the ends are left out.
std::vector<PlacedImage> PickImages(const CameraConfig& initial, const CameraConfig& calibrated,
                                    const SceneMap& map, const CameraSegment& segment,
                                    int max_images, const ImageWindow& window) {
  std::vector<PlacedImage> placed;
  const auto& images = segment.colour_images.empty() ? segment.images : segment.colour_images;
  for (const auto& [stamp_ns, pixels] : images) {
    const Timestamp time_ns = AddSeconds(stamp_ns, calibrated.time_offset_s);
    if (time_ns < window.start_ns || time_ns > window.end_ns) continue;
    const auto before = ImagePoseOf(initial, map.map_from_lidar, stamp_ns);
    const auto after = ImagePoseOf(calibrated, map.map_from_lidar, stamp_ns);
    if (before && after && !pixels.empty()) placed.push_back({pixels, *before, *after});
  }
  const std::size_t wanted = static_cast<std::size_t>(max_images);
  if (placed.size() <= wanted) return placed;
  std::vector<PlacedImage> picked;
  for (std::size_t i = 0; i < wanted; ++i) {
    picked.push_back(placed[(2 * i + 1) * placed.size() / (2 * wanted)]);
  }
  return picked;
}

/// 0xRRGGBB of a grey or BGR pixel.
int PackedColour(const cv::Mat& image, const cv::Point& pixel) {
  if (image.channels() == 1) return 0x010101 * image.at<std::uint8_t>(pixel);
  const cv::Vec3b& bgr = image.at<cv::Vec3b>(pixel);
  return bgr[0] | bgr[1] << 8 | bgr[2] << 16;
}

}  // namespace

Result<std::vector<CameraOverlays>> DrawOverlays(const Rig& initial, const Rig& calibrated,
                                                 const SceneMap& map,
                                                 const std::vector<CameraSegment>& segments,
                                                 int max_images) {
  const OverlayOptions options;
  std::vector<CameraOverlays> overlays;
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const CameraConfig& camera = initial.cameras[i];
    const std::vector<PlacedImage> images =
        PickImages(camera, calibrated.cameras[i], map, segments[i], max_images, {});
    if (images.empty()) continue;
    std::vector<Result<cv::Mat>> drawings(2 * images.size(),
                                          Result<cv::Mat>(Status::Cancelled("not drawn")));
    tbb::parallel_for(std::size_t{0}, drawings.size(), [&](std::size_t k) {
      const PlacedImage& image = images[k / 2];
      const bool is_after = k % 2 == 1;
      drawings[k] = DrawOverlay(image.pixels, is_after ? calibrated.cameras[i] : camera, map.points,
                                is_after ? image.calibrated : image.initial,
                                camera.name + (is_after ? " after" : " before"), options);
    });
    std::vector<cv::Mat> before;
    std::vector<cv::Mat> after;
    for (std::size_t k = 0; k < drawings.size(); ++k) {
      if (!drawings[k].ok()) return drawings[k].status();
      (k % 2 == 1 ? after : before).push_back(*drawings[k]);
    }
    CameraOverlays of_camera;
    of_camera.camera = camera.name;
    cv::vconcat(before, of_camera.before);
    cv::vconcat(after, of_camera.after);
    overlays.push_back(of_camera);
  }
  return overlays;
}

int NumImagesForColour(const Trajectory& map_from_lidar) {
  constexpr double kImageEvery_m = 15.0;
  constexpr double kMin = 12.0;
  constexpr double kMax = 48.0;  // each costs a look at every point of the map
  return static_cast<int>(std::clamp(map_from_lidar.Length() / kImageEvery_m, kMin, kMax));
}

std::vector<int> ColourMap(const Rig& calibrated, const SceneMap& map,
                           const std::vector<CameraSegment>& segments, int max_images,
                           const ImageWindow& window) {
  std::vector<int> colours(map.points.size(), -1);
  std::vector<double> range_m(map.points.size(), std::numeric_limits<double>::infinity());
  const OverlayOptions options;
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const CameraConfig& camera = calibrated.cameras[i];
    if (!camera.model) continue;
    const std::vector<PlacedImage> images =
        PickImages(camera, camera, map, segments[i], max_images, window);
    std::vector<std::vector<VisiblePoint>> visible(images.size());
    tbb::parallel_for(std::size_t{0}, images.size(), [&](std::size_t k) {
      visible[k] = FindVisiblePoints(*camera.model, map.points, images[k].calibrated, options);
    });
    for (std::size_t k = 0; k < images.size(); ++k) {
      for (const VisiblePoint& seen : visible[k]) {
        if (seen.range_m >= range_m[seen.index]) continue;
        const cv::Point pixel(static_cast<int>(std::lround(seen.pixel.x())),
                              static_cast<int>(std::lround(seen.pixel.y())));
        if (!cv::Rect(cv::Point(), images[k].pixels.size()).contains(pixel)) continue;
        range_m[seen.index] = seen.range_m;
        colours[seen.index] = PackedColour(images[k].pixels, pixel);
      }
    }
  }
  return colours;
}

}  // namespace scenecalib
