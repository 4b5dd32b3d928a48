#include "image_pairs.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>

#include "scenecalib/sensor/image_pose.h"
#include "surface_view.h"

// Map of this file: AddFrames picks images and casts their rays; PairsOfCameras and PairsInTime
// join frames; MakeComparison lists what both images of a pair see, with the pixels' derivatives by
// the judged camera's pose; AddImages smooths the images that are compared.

namespace scenecalib {
namespace {

using AxisValues = Eigen::Array<double, kNumAxes, 1>;

constexpr int kNumCells = 12000;

struct Frame {
  std::size_t camera = 0;
  const cv::Mat* image = nullptr;
  ImagePose pose;
  std::optional<SurfaceView> view;
};

struct Pair {
  std::size_t other = 0;  // frame compared with
  std::size_t frame = 0;  // frame of the camera that is judged
  int other_level = 0;    // how much the images are smoothed, so that both show the same detail
  int level = 0;
};

/// Perturbation that one unit of the scaled pose stands for.
AxisValues Ranges(const MiscalibrationOptions& options) {
  const double max_rotation_rad = options.max_rotation_deg * 3.14159265358979323846 / 180.0;
  AxisValues ranges;
  ranges.head<3>() = options.max_translation_m;
  ranges.tail<3>() = max_rotation_rad;
  return ranges;
}

/// The image nearest to a time on the lidar's clock; end() when none is near enough.
std::map<Timestamp, cv::Mat>::const_iterator Nearest(const std::map<Timestamp, cv::Mat>& images,
                                                     Timestamp lidar_stamp_ns, double time_offset_s,
                                                     double max_difference_s) {
  const Timestamp wanted = AddSeconds(lidar_stamp_ns, -time_offset_s);
  auto nearest = images.lower_bound(wanted);
  if (nearest == images.end() ||
      (nearest != images.begin() && wanted - std::prev(nearest)->first < nearest->first - wanted)) {
    if (nearest == images.begin()) return images.end();
    --nearest;
  }
  const double difference_s = std::abs(SecondsBetween(nearest->first, wanted));
  return difference_s <= max_difference_s ? nearest : images.end();
}

/// A frame of the camera near the time, without its view.
std::optional<Frame> MakeFrame(const Rig& rig, std::size_t camera, const SceneMap& map,
                               const std::map<Timestamp, cv::Mat>& images, Timestamp time_ns,
                               const MiscalibrationOptions& options) {
  const CameraConfig& config = rig.cameras[camera];
  const auto image = Nearest(images, time_ns, config.time_offset_s, options.max_stamp_difference_s);
  if (image == images.end()) return std::nullopt;
  const auto pose = ImagePoseOf(config, map.map_from_lidar, image->first);
  if (!pose || image->second.type() != CV_8UC1 || image->second.cols != config.model->width_px() ||
      image->second.rows != config.model->height_px()) {
    return std::nullopt;
  }
  Frame frame;
  frame.camera = camera;
  frame.image = &image->second;
  frame.pose = *pose;
  return frame;
}

/// Per time one frame of each camera and a second one later; slots of frames that do not exist, or
/// that nobody asked for, are empty. The slot of (time, camera, later) is
/// (time * num_cameras + camera) * 2 + later.
using Frames = std::vector<std::optional<Frame>>;

/// Fills the slots of these cameras, all of them the first or all the later ones.
void AddFrames(const Rig& rig, const SceneMap& map, const RayCaster& caster,
               const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
               const MiscalibrationOptions& options, const std::atomic<bool>& cancelled,
               const std::vector<bool>& cameras, bool later, Frames* frames) {
  frames->resize(static_cast<std::size_t>(options.num_times) * rig.cameras.size() * 2);
  const double duration_s =
      SecondsBetween(map.map_from_lidar.start_ns(), map.map_from_lidar.end_ns());
  tbb::parallel_for(std::size_t{0}, frames->size() / 2, [&](std::size_t i) {
    const std::size_t slot = 2 * i + (later ? 1 : 0);
    const std::size_t camera = i % rig.cameras.size();
    const std::size_t time = i / rig.cameras.size();
    const CameraConfig& config = rig.cameras[camera];
    if (cancelled || !cameras[camera] || !config.model || images[camera] == nullptr) return;
    const double elapsed_s = duration_s * (static_cast<double>(time) + 0.5) / options.num_times +
                             (later ? options.pair_separation_s : 0.0);
    std::optional<Frame> frame =
        MakeFrame(rig, camera, map, *images[camera],
                  AddSeconds(map.map_from_lidar.start_ns(), elapsed_s), options);
    if (!frame) return;
    frame->view.emplace(*config.model, frame->pose, caster, kNumCells,
                        options.seed + static_cast<int>(slot));
    (*frames)[slot] = std::move(frame);
  });
}

/// Angle that a pixel in the middle of the image spans.
double RadPerPixel(const CameraModel& camera) {
  const Eigen::Vector2d center = camera.tunable().principal_point_px;
  const auto a = camera.Unproject(center);
  const auto b = camera.Unproject(center + Eigen::Vector2d::UnitX());
  return a && b ? std::acos(std::min(1.0, a->dot(*b))) : 1e-3;
}

/// The finer camera is smoothed to the coarser one's detail, in steps of a factor of sqrt(2).
Pair MakePair(const Frames& frames, const Rig& rig, std::size_t other, std::size_t slot) {
  const double ratio = RadPerPixel(*rig.cameras[frames[other]->camera].model) /
                       RadPerPixel(*rig.cameras[frames[slot]->camera].model);
  const int level = static_cast<int>(std::lround(2.0 * std::log2(ratio)));
  return {other, slot, std::max(0, -level), std::max(0, level)};
}

/// Every camera with every other one at about the same time.
std::vector<Pair> PairsOfCameras(const Frames& frames, const Rig& rig) {
  const std::size_t num_cameras = rig.cameras.size();
  std::vector<Pair> pairs;
  for (std::size_t slot = 0; slot < frames.size(); slot += 2) {
    if (!frames[slot]) continue;
    const std::size_t first_of_time = slot - slot % (2 * num_cameras);
    for (std::size_t other = first_of_time; other < first_of_time + 2 * num_cameras; other += 2) {
      if (other != slot && frames[other]) pairs.push_back(MakePair(frames, rig, other, slot));
    }
  }
  return pairs;
}

/// Cameras with themselves a little later, where the later frames exist.
std::vector<Pair> PairsInTime(const Frames& frames, const Rig& rig) {
  std::vector<Pair> pairs;
  for (std::size_t slot = 0; slot < frames.size(); slot += 2) {
    if (frames[slot] && frames[slot + 1]) pairs.push_back(MakePair(frames, rig, slot + 1, slot));
  }
  return pairs;
}

/// Pixel of a map point and its derivative by a motion of the camera in its own frame, per unit of
/// the scaled pose; none when it comes too near to the border to be perturbed.
std::optional<std::pair<Eigen::Vector2d, PixelByPose>> Place(
    const Frame& frame, const CameraModel& model, const AxisValues& ranges,
    const Eigen::Vector3d& point_in_map_m) {
  const auto seen_m = frame.pose.WhenSeen(model, point_in_map_m);
  if (!seen_m) return std::nullopt;
  const Eigen::Vector3d& point_m = *seen_m;
  ProjectionJacobians jacobians;
  const auto pixel = model.Project(point_m, &jacobians);
  if (!pixel) return std::nullopt;
  Eigen::Matrix<double, 3, kNumAxes> point_by_pose;
  point_by_pose.leftCols<3>() = -Eigen::Matrix3d::Identity();
  point_by_pose.rightCols<3>() << 0.0, -point_m.z(), point_m.y(), point_m.z(), 0.0, -point_m.x(),
      -point_m.y(), point_m.x(), 0.0;
  const Eigen::Matrix<double, 2, kNumAxes> by_pose =
      jacobians.pixel_by_point * point_by_pose * ranges.matrix().asDiagonal();
  // All axes at their bound together, and the base of the coarsest gradient.
  const double margin_px = 3.0 + by_pose.cwiseAbs().rowwise().sum().maxCoeff();
  if (pixel->x() < margin_px || pixel->y() < margin_px ||
      pixel->x() > model.width_px() - 1 - margin_px ||
      pixel->y() > model.height_px() - 1 - margin_px) {
    return std::nullopt;
  }
  return std::make_pair(*pixel, PixelByPose(by_pose.cast<float>()));
}

/// Whether a frame sees a map point on a surface: without the derivatives that Place needs, for
/// most points lie elsewhere.
bool SeesAtAll(const Frame& frame, const CameraModel& model,
               const Eigen::Vector3d& point_in_map_m) {
  const auto pixel = frame.pose.Project(model, point_in_map_m);
  return pixel && frame.view->Sees(point_in_map_m, *pixel);
}

std::optional<Comparison> MakeComparison(const Frame& other, const Frame& frame, const Rig& rig,
                                         const MiscalibrationOptions& options) {
  const CameraModel& model = *rig.cameras[frame.camera].model;
  const CameraModel& other_model = *rig.cameras[other.camera].model;
  const AxisValues ranges = Ranges(options);
  Comparison comparison;
  comparison.same_camera = other.camera == frame.camera;
  std::vector<std::pair<Eigen::Vector2d, PixelByPose>> here;
  std::vector<std::pair<Eigen::Vector2d, PixelByPose>> there;
  for (const SurfaceView::Cell& cell : frame.view->cells()) {
    if (!cell.inside || !SeesAtAll(other, other_model, cell.point_in_map_m)) continue;
    const auto other_place = Place(other, other_model, ranges, cell.point_in_map_m);
    if (!other_place) continue;
    const auto place = Place(frame, model, ranges, cell.point_in_map_m);
    if (!place) continue;
    here.push_back(*place);
    there.push_back(*other_place);
  }
  if (here.size() < static_cast<std::size_t>(options.min_points)) return std::nullopt;
  const std::size_t count = std::min(here.size(), static_cast<std::size_t>(options.max_points));
  for (std::size_t k = 0; k < count; ++k) {
    const std::size_t i = k * here.size() / count;
    comparison.pixels.push_back(here[i].first.cast<float>());
    comparison.pixels_by_pose.push_back(here[i].second);
    comparison.other_pixels.push_back(there[i].first.cast<float>());
    if (comparison.same_camera) {
      comparison.other_pixels_by_pose.push_back(there[i].second);
    }
  }
  return comparison;
}

/// Appends the comparisons of the pairs that share enough points, and those pairs.
void AddComparisons(const Frames& frames, const std::vector<Pair>& candidates, const Rig& rig,
                    const MiscalibrationOptions& options, std::vector<Pair>* pairs,
                    std::vector<Comparison>* comparisons) {
  std::vector<std::optional<Comparison>> made(candidates.size());
  tbb::parallel_for(std::size_t{0}, candidates.size(), [&](std::size_t i) {
    made[i] =
        MakeComparison(*frames[candidates[i].other], *frames[candidates[i].frame], rig, options);
  });
  for (std::size_t i = 0; i < made.size(); ++i) {
    if (!made[i]) continue;
    pairs->push_back(candidates[i]);
    comparisons->push_back(std::move(*made[i]));
  }
}

/// Smooths what the comparisons need and no rig before needed, and hands it to them.
void AddImages(const Frames& frames, const std::vector<Pair>& pairs, double smoothing_px,
               BandPassImages* images, std::vector<Comparison>* comparisons) {
  std::vector<BandPassImages::iterator> missing;
  const auto need = [&](std::size_t frame, int level) {
    const auto [at, is_new] = images->try_emplace({frames[frame]->image, level});
    if (is_new) missing.push_back(at);
  };
  for (const Pair& pair : pairs) {
    need(pair.frame, pair.level);
    need(pair.other, pair.other_level);
  }
  tbb::parallel_for(std::size_t{0}, missing.size(), [&](std::size_t i) {
    const auto& [image, level] = missing[i]->first;
    missing[i]->second = BandPassImage(*image, smoothing_px * std::pow(2.0, 0.5 * level));
  });
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    Comparison& comparison = (*comparisons)[i];
    comparison.image = &images->at({frames[pairs[i].frame]->image, pairs[i].level});
    comparison.other_image = &images->at({frames[pairs[i].other]->image, pairs[i].other_level});
    if (comparison.same_camera) continue;
    for (const Eigen::Vector2f& pixel : comparison.other_pixels) {
      comparison.other_values.push_back(comparison.other_image->At(pixel.x(), pixel.y()));
    }
  }
}

}  // namespace

int NumTimes(const Rig& rig, const MiscalibrationOptions& options) {
  constexpr double kMaxPixels = 4e8;  // of two bytes
  constexpr double kLevels = 2.0;     // of smoothing, about, by which an image is kept
  constexpr int kEnough = 20;
  double pixels = 1.0;
  for (const CameraConfig& camera : rig.cameras) {
    if (camera.model) pixels += kLevels * camera.model->width_px() * camera.model->height_px();
  }
  const auto affordable = static_cast<int>(std::min(kMaxPixels / pixels, 1e6));
  return std::min(options.num_times, std::max(affordable, kEnough));
}

ImagePairs CollectImagePairs(const Rig& rig, const SceneMap& map, const RayCaster& caster,
                             const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
                             const MiscalibrationOptions& wanted,
                             const std::atomic<bool>& cancelled, BandPassImages* band_pass) {
  MiscalibrationOptions options = wanted;
  options.num_times = NumTimes(rig, wanted);
  ImagePairs result;
  std::vector<Comparison>& comparisons = result.comparisons;
  Frames frames;
  std::vector<Pair> pairs;
  AddFrames(rig, map, caster, images, options, cancelled,
            std::vector<bool>(rig.cameras.size(), true), false, &frames);
  AddComparisons(frames, PairsOfCameras(frames, rig), rig, options, &pairs, &comparisons);
  // A camera that shares views with others is judged by those alone: the images of one camera at
  // two times hardly show a shift that both share.
  std::vector<bool> alone(rig.cameras.size(), true);
  for (const Pair& pair : pairs) alone[frames[pair.frame]->camera] = false;
  AddFrames(rig, map, caster, images, options, cancelled, alone, true, &frames);
  AddComparisons(frames, PairsInTime(frames, rig), rig, options, &pairs, &comparisons);

  result.pairs_of_camera.resize(rig.cameras.size());
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    result.pairs_of_camera[frames[pairs[i].frame]->camera].push_back(i);
  }
  if (cancelled) return {};
  AddImages(frames, pairs, options.smoothing_px, band_pass, &comparisons);
  return result;
}

}  // namespace scenecalib
