#include "scenecalib/evaluation/miscalibration_rate.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <opencv2/imgproc.hpp>

#include "scenecalib/base/random.h"
#include "scenecalib/evaluation/overlay.h"
#include "scenecalib/geometry/so3.h"

// Map of this file: ChooseFrames picks images; each frame gets the list of map points it sees;
// ChoosePairs joins frames; RatePair perturbs the pose of the pair's second frame and compares.

namespace scenecalib {
namespace {

constexpr int kNumAxes = 6;  // x, y, z, pitch, yaw, roll: translations and rotations by axis
using AxisRates = std::array<double, kNumAxes>;

struct Frame {
  std::size_t camera = 0;
  cv::Mat image;  // smoothed, so that brightness varies smoothly with the pose
  Rigid3 lidar_from_map;
  std::vector<std::size_t> visible_points;  // sorted
};

struct Pair {
  std::size_t other = 0;  // frame compared with
  std::size_t frame = 0;  // frame of the camera that is judged
};

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

/// A frame of the camera near the time, without its visible points.
std::optional<Frame> MakeFrame(const Rig& rig, std::size_t camera, const SceneMap& map,
                               const std::map<Timestamp, cv::Mat>& images, Timestamp time_ns,
                               const MiscalibrationOptions& options) {
  const CameraConfig& config = rig.cameras[camera];
  const auto image = Nearest(images, time_ns, config.time_offset_s, options.max_stamp_difference_s);
  if (image == images.end()) return std::nullopt;
  const auto map_from_lidar =
      map.map_from_lidar.Interpolate(AddSeconds(image->first, config.time_offset_s));
  if (!map_from_lidar || image->second.type() != CV_8UC1 ||
      image->second.cols != config.model->width_px() ||
      image->second.rows != config.model->height_px()) {
    return std::nullopt;
  }
  Frame frame;
  frame.camera = camera;
  frame.image = image->second;
  frame.lidar_from_map = map_from_lidar->Inverse();
  return frame;
}

/// Per time one frame of each camera and a second one later; slots of frames that do not exist are
/// empty. The slot of (time, camera, later) is (time * num_cameras + camera) * 2 + later.
std::vector<std::optional<Frame>> ChooseFrames(
    const Rig& rig, const SceneMap& map,
    const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
    const MiscalibrationOptions& options) {
  std::vector<std::optional<Frame>> frames(static_cast<std::size_t>(options.num_times) *
                                           rig.cameras.size() * 2);
  const double duration_s =
      SecondsBetween(map.map_from_lidar.start_ns(), map.map_from_lidar.end_ns());
  tbb::parallel_for(std::size_t{0}, frames.size(), [&](std::size_t slot) {
    const std::size_t camera = slot / 2 % rig.cameras.size();
    const std::size_t time = slot / 2 / rig.cameras.size();
    const CameraConfig& config = rig.cameras[camera];
    if (!config.model || images[camera] == nullptr) return;
    const double elapsed_s = duration_s * (static_cast<double>(time) + 0.5) / options.num_times +
                             (slot % 2 == 1 ? options.pair_separation_s : 0.0);
    std::optional<Frame> frame =
        MakeFrame(rig, camera, map, *images[camera],
                  AddSeconds(map.map_from_lidar.start_ns(), elapsed_s), options);
    if (!frame) return;
    const Rigid3 camera_from_map = config.lidar_from_camera.Inverse() * frame->lidar_from_map;
    for (const VisiblePoint& point :
         FindVisiblePoints(*config.model, map.points, camera_from_map, OverlayOptions())) {
      frame->visible_points.push_back(point.index);
    }
    cv::Mat smooth;
    cv::GaussianBlur(frame->image, smooth, cv::Size(5, 5), 1.0);
    frame->image = smooth;
    frames[slot] = std::move(frame);
  });
  return frames;
}

std::vector<Pair> ChoosePairs(const std::vector<std::optional<Frame>>& frames,
                              std::size_t num_cameras) {
  std::vector<Pair> pairs;
  for (std::size_t slot = 0; slot < frames.size(); slot += 2) {
    if (!frames[slot]) continue;
    if (frames[slot + 1]) pairs.push_back({slot + 1, slot});
    const std::size_t first_of_time = slot - slot % (2 * num_cameras);
    for (std::size_t other = first_of_time; other < first_of_time + 2 * num_cameras; other += 2) {
      if (other != slot && frames[other]) pairs.push_back({other, slot});
    }
  }
  return pairs;
}

/// Brightness between four pixels; none outside the image.
std::optional<double> Brightness(const cv::Mat& image, const Eigen::Vector2d& pixel) {
  const int x = static_cast<int>(std::floor(pixel.x()));
  const int y = static_cast<int>(std::floor(pixel.y()));
  if (x < 0 || y < 0 || x + 1 >= image.cols || y + 1 >= image.rows) return std::nullopt;
  const double fx = pixel.x() - x;
  const double fy = pixel.y() - y;
  const unsigned char* upper = image.ptr<unsigned char>(y) + x;
  const unsigned char* lower = image.ptr<unsigned char>(y + 1) + x;
  return (1.0 - fy) * ((1.0 - fx) * upper[0] + fx * upper[1]) +
         fy * ((1.0 - fx) * lower[0] + fx * lower[1]);
}

/// Brightness of points under a pose; NaN where the camera does not see them.
std::vector<double> Sample(const Frame& frame, const CameraConfig& config,
                           const Rigid3& lidar_from_camera,
                           const std::vector<Eigen::Vector3d>& points_in_map_m) {
  const Rigid3 camera_from_map = lidar_from_camera.Inverse() * frame.lidar_from_map;
  const Eigen::Matrix3d rotation = camera_from_map.RotationMatrix();
  std::vector<double> values(points_in_map_m.size(), std::nan(""));
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto pixel =
        config.model->Project(rotation * points_in_map_m[i] + camera_from_map.translation);
    if (!pixel) continue;
    const std::optional<double> value = Brightness(frame.image, *pixel);
    if (value) values[i] = *value;
  }
  return values;
}

/// One minus the normalised cross-correlation, over what is seen in both.
double PhotometricError(const std::vector<double>& a, const std::vector<double>& b) {
  double n = 0.0, sum_a = 0.0, sum_b = 0.0, sum_aa = 0.0, sum_bb = 0.0, sum_ab = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (std::isnan(a[i]) || std::isnan(b[i])) continue;
    n += 1.0;
    sum_a += a[i];
    sum_b += b[i];
    sum_aa += a[i] * a[i];
    sum_bb += b[i] * b[i];
    sum_ab += a[i] * b[i];
  }
  const double variance_a = n * sum_aa - sum_a * sum_a;
  const double variance_b = n * sum_bb - sum_b * sum_b;
  // An image without contrast is like nothing.
  if (!(variance_a > 0.0 && variance_b > 0.0)) return 1.0;
  return 1.0 - (n * sum_ab - sum_a * sum_b) / std::sqrt(variance_a * variance_b);
}

std::vector<Eigen::Vector3d> SharedPoints(const Frame& a, const Frame& b, const SceneMap& map,
                                          const MiscalibrationOptions& options) {
  std::vector<std::size_t> shared;
  std::set_intersection(a.visible_points.begin(), a.visible_points.end(), b.visible_points.begin(),
                        b.visible_points.end(), std::back_inserter(shared));
  std::vector<Eigen::Vector3d> points;
  if (shared.size() < static_cast<std::size_t>(options.min_points)) return points;
  const std::size_t count = std::min(shared.size(), static_cast<std::size_t>(options.max_points));
  for (std::size_t i = 0; i < count; ++i) {
    points.push_back(map.points[shared[i * shared.size() / count]].position_m.cast<double>());
  }
  return points;
}

/// Share of perturbed poses with a lower error, per axis; none without enough shared points.
std::optional<AxisRates> RatePair(const Frame& other, const Frame& frame, const Rig& rig,
                                  const SceneMap& map, const std::vector<double>& fractions,
                                  const MiscalibrationOptions& options) {
  const std::vector<Eigen::Vector3d> points = SharedPoints(other, frame, map, options);
  if (points.empty()) return std::nullopt;
  const CameraConfig& config = rig.cameras[frame.camera];
  const CameraConfig& other_config = rig.cameras[other.camera];
  const bool same_camera = other.camera == frame.camera;
  const std::vector<double> other_values =
      Sample(other, other_config, other_config.lidar_from_camera, points);
  const double error =
      PhotometricError(other_values, Sample(frame, config, config.lidar_from_camera, points));
  const double max_rotation_rad = options.max_rotation_deg * 3.14159265358979323846 / 180.0;
  AxisRates rates = {};
  for (int axis = 0; axis < kNumAxes; ++axis) {
    int num_lower = 0;
    for (int sample = 0; sample < options.num_samples; ++sample) {
      const double fraction =
          fractions[static_cast<std::size_t>(axis * options.num_samples + sample)];
      const Eigen::Vector3d direction = fraction * Eigen::Vector3d::Unit(axis % 3);
      const Rigid3 shift =
          axis < 3 ? Rigid3(Eigen::Quaterniond::Identity(), options.max_translation_m * direction)
                   : Rigid3(ExpSo3(max_rotation_rad * direction), Eigen::Vector3d::Zero());
      const Rigid3 perturbed = config.lidar_from_camera * shift;
      const std::vector<double> values = Sample(frame, config, perturbed, points);
      const double perturbed_error = PhotometricError(
          same_camera ? Sample(other, other_config, perturbed, points) : other_values, values);
      if (perturbed_error < error) ++num_lower;
    }
    rates[axis] = static_cast<double>(num_lower) / options.num_samples;
  }
  return rates;
}

}  // namespace

Result<std::vector<std::optional<MiscalibrationRate>>> ComputeMiscalibrationRates(
    const Rig& rig, const SceneMap& map,
    const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
    const MiscalibrationOptions& options) {
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  if (images.size() != rig.cameras.size()) {
    return Status::InvalidArgument("miscalibration rate: images of " +
                                   std::to_string(images.size()) + " cameras for a rig of " +
                                   std::to_string(rig.cameras.size()));
  }
  std::vector<std::optional<MiscalibrationRate>> rates(rig.cameras.size());
  if (map.map_from_lidar.empty() || rig.cameras.empty()) return rates;
  const std::vector<std::optional<Frame>> frames = ChooseFrames(rig, map, images, options);
  const std::vector<Pair> pairs = ChoosePairs(frames, rig.cameras.size());
  Random random(static_cast<std::uint64_t>(options.seed));
  std::vector<double> fractions;
  for (int i = 0; i < kNumAxes * options.num_samples; ++i) {
    fractions.push_back(random.Uniform(-1.0, 1.0));
  }
  std::vector<std::optional<AxisRates>> pair_rates(pairs.size());
  tbb::parallel_for(std::size_t{0}, pairs.size(), [&](std::size_t i) {
    pair_rates[i] =
        RatePair(*frames[pairs[i].other], *frames[pairs[i].frame], rig, map, fractions, options);
  });
  std::vector<AxisRates> sums(rig.cameras.size(), AxisRates{});
  std::vector<int> counts(rig.cameras.size(), 0);
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    if (!pair_rates[i]) continue;
    const std::size_t camera = frames[pairs[i].frame]->camera;
    for (int axis = 0; axis < kNumAxes; ++axis) sums[camera][axis] += (*pair_rates[i])[axis];
    ++counts[camera];
  }
  for (std::size_t camera = 0; camera < rates.size(); ++camera) {
    if (counts[camera] == 0) continue;
    for (double& sum : sums[camera]) sum /= counts[camera];
    const AxisRates& mean = sums[camera];
    // Rotations by axis are about right (pitch), down (yaw) and forward (roll).
    rates[camera] = MiscalibrationRate{mean[0], mean[1], mean[2], mean[5], mean[3], mean[4]};
  }
  return rates;
}

}  // namespace scenecalib
