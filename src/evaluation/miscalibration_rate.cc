#include "scenecalib/evaluation/miscalibration_rate.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <iterator>
#include <utility>

#include "band_pass.h"
#include "scenecalib/base/random.h"
#include "surface_view.h"

// Map of this file: AddFrames picks images and casts their rays; PairsOfCameras and PairsInTime
// join frames; MakeComparison lists what both images of a pair see, with the pixels' derivatives by
// the judged camera's pose; FindOptima finds each camera's best pose over all its pairs; RateCamera
// perturbs.

namespace scenecalib {
namespace {

using Rates = std::vector<std::optional<MiscalibrationRate>>;

constexpr int kNumAxes = 6;  // x, y, z, pitch, yaw, roll: translations and rotations by axis
using AxisValues = Eigen::Array<double, kNumAxes, 1>;
using Vector6 = Eigen::Matrix<double, kNumAxes, 1>;
using Matrix6 = Eigen::Matrix<double, kNumAxes, kNumAxes>;
using PixelByPose = Eigen::Matrix<float, 2, kNumAxes>;

constexpr int kNumCells = 12000;
/// Differences beyond this many local contrasts are other things: cars, shadows, reflections.
constexpr double kMaxDifference = 0.5;
/// Gauss-Newton steps, from coarse to fine: the base over which brightness is differentiated, and
/// the difference beyond which a point does not count.
struct OptimumStep {
  float gradient_base_px;
  double max_difference;
};
constexpr OptimumStep kSteps[] = {{3.0F, 3.0}, {3.0F, 2.0}, {2.5F, 1.5}, {2.0F, 1.0},
                                  {1.5F, 0.8}, {1.0F, 0.5}, {1.0F, 0.5}, {1.0F, 0.5}};
constexpr OptimumStep kFinest = {1.0F, kMaxDifference};

struct Frame {
  std::size_t camera = 0;
  const cv::Mat* image = nullptr;
  Rigid3 map_from_camera;
  std::optional<SurfaceView> view;
};

struct Pair {
  std::size_t other = 0;  // frame compared with
  std::size_t frame = 0;  // frame of the camera that is judged
  int other_level = 0;    // how much the images are smoothed, so that both show the same detail
  int level = 0;
};

/// Smoothed images by image and level; they do not depend on the rig.
using BandPassImages = std::map<std::pair<const cv::Mat*, int>, BandPassImage>;

/// What a pair's images show of the points that both see. Pixels move with the judged camera's pose
/// to first order: the perturbations are small.
struct Comparison {
  const BandPassImage* image = nullptr;
  const BandPassImage* other_image = nullptr;
  bool same_camera = false;
  std::vector<Eigen::Vector2f> pixels;
  std::vector<PixelByPose> pixels_by_pose;
  std::vector<Eigen::Vector2f> other_pixels;
  std::vector<PixelByPose> other_pixels_by_pose;  // only of the same camera
  std::vector<float> other_values;                // only of another camera
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
  const auto map_from_lidar =
      map.map_from_lidar.Interpolate(AddSeconds(image->first, config.time_offset_s));
  if (!map_from_lidar || image->second.type() != CV_8UC1 ||
      image->second.cols != config.model->width_px() ||
      image->second.rows != config.model->height_px()) {
    return std::nullopt;
  }
  Frame frame;
  frame.camera = camera;
  frame.image = &image->second;
  frame.map_from_camera = *map_from_lidar * config.lidar_from_camera;
  return frame;
}

/// Per time one frame of each camera and a second one later; slots of frames that do not exist, or
/// that nobody asked for, are empty. The slot of (time, camera, later) is
/// (time * num_cameras + camera) * 2 + later.
using Frames = std::vector<std::optional<Frame>>;

/// Fills the slots of these cameras, all of them the first or all the later ones.
void AddFrames(const Rig& rig, const SceneMap& map, const RayCaster& caster,
               const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
               const MiscalibrationOptions& options, const std::vector<bool>& cameras, bool later,
               Frames* frames) {
  frames->resize(static_cast<std::size_t>(options.num_times) * rig.cameras.size() * 2);
  const double duration_s =
      SecondsBetween(map.map_from_lidar.start_ns(), map.map_from_lidar.end_ns());
  tbb::parallel_for(std::size_t{0}, frames->size() / 2, [&](std::size_t i) {
    const std::size_t slot = 2 * i + (later ? 1 : 0);
    const std::size_t camera = i % rig.cameras.size();
    const std::size_t time = i / rig.cameras.size();
    const CameraConfig& config = rig.cameras[camera];
    if (!cameras[camera] || !config.model || images[camera] == nullptr) return;
    const double elapsed_s = duration_s * (static_cast<double>(time) + 0.5) / options.num_times +
                             (later ? options.pair_separation_s : 0.0);
    std::optional<Frame> frame =
        MakeFrame(rig, camera, map, *images[camera],
                  AddSeconds(map.map_from_lidar.start_ns(), elapsed_s), options);
    if (!frame) return;
    frame->view.emplace(*config.model, frame->map_from_camera, caster, kNumCells,
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
  const Eigen::Vector3d point_m = frame.map_from_camera.Inverse() * point_in_map_m;
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
    if (!cell.inside) continue;
    const auto other_place = Place(other, other_model, ranges, cell.point_in_map_m);
    if (!other_place || !other.view->Sees(cell.point_in_map_m, other_place->first)) continue;
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

/// Sums over the points of the truncated squared difference, for each value of one axis of a scaled
/// pose. Point by point, because the values move it by few pixels.
std::vector<double> PhotometricErrors(const Comparison& comparison, const Vector6& pose, int axis,
                                      const std::vector<float>& values) {
  Eigen::Matrix<float, kNumAxes, 1> p = pose.cast<float>();
  p[axis] = 0.0F;
  constexpr auto kMaxSquare = static_cast<float>(kMaxDifference * kMaxDifference);
  std::vector<double> sums(values.size(), 0.0);
  for (std::size_t i = 0; i < comparison.pixels.size(); ++i) {
    const Eigen::Vector2f pixel = comparison.pixels[i] + comparison.pixels_by_pose[i] * p;
    const Eigen::Vector2f by_value = comparison.pixels_by_pose[i].col(axis);
    Eigen::Vector2f other_pixel = comparison.other_pixels[i];
    Eigen::Vector2f other_by_value = Eigen::Vector2f::Zero();
    if (comparison.same_camera) {
      other_pixel += comparison.other_pixels_by_pose[i] * p;
      other_by_value = comparison.other_pixels_by_pose[i].col(axis);
    }
    for (std::size_t k = 0; k < values.size(); ++k) {
      const Eigen::Vector2f moved = pixel + values[k] * by_value;
      const Eigen::Vector2f other_moved = other_pixel + values[k] * other_by_value;
      const float other_value = comparison.same_camera
                                    ? comparison.other_image->At(other_moved.x(), other_moved.y())
                                    : comparison.other_values[i];
      const float difference = comparison.image->At(moved.x(), moved.y()) - other_value;
      sums[k] += std::min(difference * difference, kMaxSquare);
    }
  }
  return sums;
}

/// Normal equations of the differences that are not truncated.
struct Normal {
  Matrix6 h = Matrix6::Zero();
  Vector6 b = Vector6::Zero();
  double square_sum = 0.0;
  int count = 0;

  void Add(const Normal& other) {
    h += other.h;
    b += other.b;
    square_sum += other.square_sum;
    count += other.count;
  }
};

Eigen::RowVector2f Gradient(const BandPassImage& image, const Eigen::Vector2f& pixel,
                            float base_px) {
  const float half = 0.5F * base_px;
  return Eigen::RowVector2f(
             image.At(pixel.x() + half, pixel.y()) - image.At(pixel.x() - half, pixel.y()),
             image.At(pixel.x(), pixel.y() + half) - image.At(pixel.x(), pixel.y() - half)) /
         base_px;
}

Normal Linearise(const Comparison& comparison, const Vector6& pose, const OptimumStep& step) {
  const Eigen::Matrix<float, kNumAxes, 1> p = pose.cast<float>();
  Normal normal;
  for (std::size_t i = 0; i < comparison.pixels.size(); ++i) {
    const Eigen::Vector2f pixel = comparison.pixels[i] + comparison.pixels_by_pose[i] * p;
    Eigen::Vector2f other_pixel = comparison.other_pixels[i];
    if (comparison.same_camera) other_pixel += comparison.other_pixels_by_pose[i] * p;
    const double difference = comparison.image->At(pixel.x(), pixel.y()) -
                              comparison.other_image->At(other_pixel.x(), other_pixel.y());
    if (std::abs(difference) >= step.max_difference) continue;
    Eigen::Matrix<float, 1, kNumAxes> by_pose =
        Gradient(*comparison.image, pixel, step.gradient_base_px) * comparison.pixels_by_pose[i];
    if (comparison.same_camera) {
      by_pose -= Gradient(*comparison.other_image, other_pixel, step.gradient_base_px) *
                 comparison.other_pixels_by_pose[i];
    }
    const Vector6 row = by_pose.transpose().cast<double>();
    normal.h += row * row.transpose();
    normal.b += difference * row;
    normal.square_sum += difference * difference;
    ++normal.count;
  }
  return normal;
}

/// Each camera's best scaled pose over all its pairs with other cameras, within the perturbations'
/// range. One camera's images at two times do not fix all six axes: there it is the given pose.
std::vector<Vector6> FindOptima(const std::vector<Comparison>& comparisons,
                                const std::vector<std::vector<std::size_t>>& pairs_of_camera) {
  std::vector<Vector6> optima(pairs_of_camera.size(), Vector6::Zero());
  for (const OptimumStep& step : kSteps) {
    std::vector<Normal> normals(comparisons.size());
    std::vector<std::pair<std::size_t, std::size_t>> tasks;  // camera, comparison
    for (std::size_t camera = 0; camera < pairs_of_camera.size(); ++camera) {
      for (const std::size_t i : pairs_of_camera[camera]) {
        if (!comparisons[i].same_camera) tasks.emplace_back(camera, i);
      }
    }
    tbb::parallel_for(std::size_t{0}, tasks.size(), [&](std::size_t t) {
      const auto& [camera, i] = tasks[t];
      normals[i] = Linearise(comparisons[i], optima[camera], step);
    });
    for (std::size_t camera = 0; camera < pairs_of_camera.size(); ++camera) {
      Normal sum;
      for (const std::size_t i : pairs_of_camera[camera]) sum.Add(normals[i]);
      if (sum.count == 0) continue;
      // What the images do not show stays at the calibration: a prior of one range per axis.
      const double variance = sum.square_sum / sum.count;
      sum.h.diagonal().array() += variance;
      sum.b += variance * optima[camera];
      optima[camera] -= sum.h.ldlt().solve(sum.b);
      optima[camera] = optima[camera].cwiseMax(-1.0).cwiseMin(1.0);
    }
  }
  return optima;
}

/// Share of the perturbed poses that look better than the given one, axis by axis.
AxisValues RateCamera(const std::vector<Comparison>& comparisons,
                      const std::vector<std::size_t>& pairs, const Vector6& optimum,
                      const std::vector<double>& fractions, const MiscalibrationOptions& options) {
  const Vector6 base = options.free_other_axes ? optimum : Vector6(Vector6::Zero());
  const auto num_samples = static_cast<std::size_t>(options.num_samples);
  AxisValues rates;
  for (int axis = 0; axis < kNumAxes; ++axis) {
    // The given pose first, then the perturbed ones.
    std::vector<float> values = {0.0F};
    const auto first = fractions.begin() + axis * options.num_samples;
    values.insert(values.end(), first, first + options.num_samples);
    std::vector<std::vector<double>> errors(pairs.size());
    tbb::parallel_for(std::size_t{0}, pairs.size(), [&](std::size_t i) {
      errors[i] = PhotometricErrors(comparisons[pairs[i]], base, axis, values);
    });
    std::vector<double> sums(values.size(), 0.0);
    for (const std::vector<double>& of_pair : errors) {
      std::transform(sums.begin(), sums.end(), of_pair.begin(), sums.begin(), std::plus<>());
    }
    const auto num_lower = std::count_if(sums.begin() + 1, sums.end(),
                                         [&](double error) { return error < sums.front(); });
    rates[axis] = static_cast<double>(num_lower) / static_cast<double>(num_samples);
  }
  return rates;
}

std::vector<double> DrawFractions(const MiscalibrationOptions& options) {
  Random random(static_cast<std::uint64_t>(options.seed));
  std::vector<double> fractions;
  for (int i = 0; i < kNumAxes * options.num_samples; ++i) {
    // One in each of num_samples equal parts of the range: uniform, with less chance in the count.
    const double part = i % options.num_samples;
    fractions.push_back(-1.0 + 2.0 * (part + random.Uniform()) / options.num_samples);
  }
  return fractions;
}

Rates RateRig(const Rig& rig, const SceneMap& map, const RayCaster& caster,
              const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
              const MiscalibrationOptions& options, BandPassImages* band_pass) {
  Rates rates(rig.cameras.size());
  Frames frames;
  std::vector<Pair> pairs;
  std::vector<Comparison> comparisons;
  AddFrames(rig, map, caster, images, options, std::vector<bool>(rig.cameras.size(), true), false,
            &frames);
  AddComparisons(frames, PairsOfCameras(frames, rig), rig, options, &pairs, &comparisons);
  // A camera that shares views with others is judged by those alone: the images of one camera at
  // two times hardly show a shift that both share.
  std::vector<bool> alone(rig.cameras.size(), true);
  for (const Pair& pair : pairs) alone[frames[pair.frame]->camera] = false;
  AddFrames(rig, map, caster, images, options, alone, true, &frames);
  AddComparisons(frames, PairsInTime(frames, rig), rig, options, &pairs, &comparisons);

  std::vector<std::vector<std::size_t>> pairs_of_camera(rig.cameras.size());
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    pairs_of_camera[frames[pairs[i].frame]->camera].push_back(i);
  }
  AddImages(frames, pairs, options.smoothing_px, band_pass, &comparisons);
  const std::vector<Vector6> optima = FindOptima(comparisons, pairs_of_camera);
  const std::vector<double> fractions = DrawFractions(options);
  for (std::size_t camera = 0; camera < rates.size(); ++camera) {
    if (pairs_of_camera[camera].empty()) continue;
    const AxisValues r =
        RateCamera(comparisons, pairs_of_camera[camera], optima[camera], fractions, options);
    // Rotations by axis are about right (pitch), down (yaw) and forward (roll).
    rates[camera] = MiscalibrationRate{r[0], r[1], r[2], r[5], r[3], r[4]};
  }
  return rates;
}

}  // namespace

FieldOfView FieldOfViewOf(const CameraModel& camera) {
  const double across_deg = 2.0 * camera.max_theta_rad() * 180.0 / 3.14159265358979323846;
  if (across_deg < 50.0) return FieldOfView::kNarrow;
  return across_deg < 160.0 ? FieldOfView::kMedium : FieldOfView::kWide;
}

const char* ToString(FieldOfView field_of_view) {
  switch (field_of_view) {
    case FieldOfView::kNarrow:
      return "30 deg";
    case FieldOfView::kMedium:
      return "70, 120 deg";
    case FieldOfView::kWide:
      break;
  }
  return "200 deg";
}

MiscalibrationRate PublishedRate(FieldOfView field_of_view) {
  switch (field_of_view) {
    case FieldOfView::kNarrow:
      return {0.265, 0.308, 0.205, 0.273, 0.155, 0.265};
    case FieldOfView::kMedium:
      return {0.210, 0.227, 0.174, 0.185, 0.150, 0.173};
    case FieldOfView::kWide:
      break;
  }
  return {0.045, 0.070, 0.066, 0.119, 0.183, 0.126};
}

Result<std::vector<Rates>> ComputeMiscalibrationRates(
    const std::vector<Rig>& rigs, const SceneMap& map,
    const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
    const MiscalibrationOptions& options) {
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  std::vector<Rates> rates;
  for (const Rig& rig : rigs) {
    if (images.size() != rig.cameras.size()) {
      return Status::InvalidArgument("miscalibration rate: images of " +
                                     std::to_string(images.size()) + " cameras for a rig of " +
                                     std::to_string(rig.cameras.size()));
    }
    rates.emplace_back(rig.cameras.size());
  }
  if (map.map_from_lidar.empty()) return rates;
  const Result<RayCaster> caster = RayCaster::Create(map);
  if (!caster.ok()) return rates;  // no surface, hence no point to compare
  BandPassImages band_pass;
  for (std::size_t i = 0; i < rigs.size(); ++i) {
    rates[i] = RateRig(rigs[i], map, *caster, images, options, &band_pass);
  }
  return rates;
}

Result<Rates> ComputeMiscalibrationRates(
    const Rig& rig, const SceneMap& map,
    const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
    const MiscalibrationOptions& options) {
  const Result<std::vector<Rates>> rates =
      ComputeMiscalibrationRates(std::vector<Rig>{rig}, map, images, options);
  if (!rates.ok()) return rates.status();
  return rates->front();
}

}  // namespace scenecalib
