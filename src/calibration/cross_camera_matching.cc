#include "scenecalib/calibration/cross_camera_matching.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "feature_point_grid.h"
#include "patch_correlation.h"
#include "scenecalib/tracking/patch_registration.h"
#include "scenecalib/tracking/plane_warp.h"
#include "warped_sampling.h"

namespace scenecalib {
namespace {

constexpr double kMinGrazingSine = 0.05;
/// Spacing of the exact warp's grid, in target pixels; between its nodes the warp is bilinear.
constexpr int kGridStep = 4;
/// From this many source pixels to a target pixel on, the source is smoothed.
constexpr double kFinerScale = 1.2;
/// Every so many grid nodes a ray tells whether the plane is what is seen there.
constexpr int kRayStep = 2;
constexpr double kOcclusionShare = 0.01;
constexpr double kOcclusionFloor_m = 0.1;
constexpr double kOffPlane_m = 0.03;
constexpr double kOffPlaneShare = 0.003;
constexpr double kMaxRange_m = 150.0;
/// Images with this share of their neighbours' sharpness are sharp.
constexpr double kSharp = 0.7;

using Candidate = std::pair<int, Timestamp>;  ///< source point, target stamp

/// Eq. (4) through a plane: pixel of one view to pixel of another, both ways alike.
struct PlaneTransfer {
  PosedView source;
  PosedView target;
  MapPlane plane;

  std::optional<Eigen::Vector2d> operator()(const Eigen::Vector2d& source_px) const {
    const auto point = MeetPlane(source, plane, source_px, kMinGrazingSine);
    if (!point) return std::nullopt;
    return target.pose->Project(*target.model, *point);
  }

  std::optional<PlaneSamples> SamplesAround(const Eigen::Vector2d& source_px,
                                            double radius_px) const {
    return SamplePlane(source, plane, source_px, radius_px, kMinGrazingSine);
  }

  /// Second-order warp about a source pixel, fitted to samples at the given radius.
  std::optional<PatchWarp> Warp(const Eigen::Vector2d& source_px, double radius_px) const {
    const auto samples = SamplesAround(source_px, radius_px);
    if (!samples) return std::nullopt;
    return WarpInto(target, *samples, radius_px);
  }
};

/// Largest and smallest singular value of a warp: the change of scale along its axes.
Eigen::Vector2d ScalesOf(const Eigen::Matrix2d& affine) {
  return Eigen::JacobiSVD<Eigen::Matrix2d>(affine).singularValues();
}

enum class Verdict { kNotSeen, kOccluded, kOffPlane, kUnlike, kWide, kUnregistered, kMatched };

struct Trial {
  Verdict verdict = Verdict::kNotSeen;
  CrossCameraMatch match;
};

/// Matches the points of one camera in the images of another.
class PairMatcher {
 public:
  PairMatcher(const std::vector<MatchingCamera>& cameras, int source, int target,
              const RayCaster& caster, const CrossCameraOptions& options)
      : source_(cameras[source]),
        target_(cameras[target]),
        source_index_(source),
        target_index_(target),
        caster_(caster),
        options_(options) {}

  /// The views of the target that show a point most like its reference view does.
  std::vector<Candidate> Candidates(const FeaturePointGrid& target_points) const {
    std::vector<int> near;
    std::vector<std::vector<Timestamp>> stamps;
    for (std::size_t i = 0; i < source_.points.size(); ++i) {
      std::vector<Timestamp> seen = target_points.StampsNear(source_.points[i].point_in_map_m);
      if (seen.empty()) continue;
      near.push_back(static_cast<int>(i));
      stamps.push_back(std::move(seen));
    }
    const std::size_t count =
        std::min(near.size(), static_cast<std::size_t>(options_.max_points_per_pair));
    std::vector<std::vector<Candidate>> by_point(count);
    tbb::parallel_for(std::size_t{0}, count, [&](std::size_t k) {
      const std::size_t i = k * near.size() / count;  // evenly spread
      by_point[k] = BestViews(near[i], stamps[i]);
    });
    std::vector<Candidate> candidates;
    for (const std::vector<Candidate>& of_point : by_point) {
      candidates.insert(candidates.end(), of_point.begin(), of_point.end());
    }
    return candidates;
  }

  Trial Match(const Candidate& candidate) const {
    Trial trial;
    trial.match.source_camera = source_index_;
    trial.match.source_point = candidate.first;
    trial.match.target_camera = target_index_;
    trial.match.target_stamp_ns = candidate.second;
    const FeaturePoint& point = source_.points[candidate.first];
    const auto transfer = TransferOf(point, candidate.second);
    if (!transfer) return trial;
    const auto warp = transfer->Warp(point.reference_px, options_.register_radius_px);
    if (!warp) return trial;
    trial.match.predicted_px = warp->center_px;
    if (IsOccluded(*transfer, warp->center_px.y())) {
      trial.verdict = Verdict::kOccluded;
      return trial;
    }
    const cv::Mat& source_image = source_.images->at(point.reference_stamp_ns);
    const cv::Mat& target_image = target_.images->at(candidate.second);
    trial.verdict = FindPeak(point, *transfer, *warp, source_image, target_image, &trial.match);
    if (trial.verdict == Verdict::kMatched) {
      trial.verdict = Refine(point, *warp, source_image, target_image, &trial.match);
    }
    return trial;
  }

 private:
  std::optional<PlaneTransfer> TransferOf(const FeaturePoint& point, Timestamp target_stamp) const {
    const auto source_pose = source_.poses.find(point.reference_stamp_ns);
    const auto target_pose = target_.poses.find(target_stamp);
    if (source_pose == source_.poses.end() || target_pose == target_.poses.end() ||
        source_.images->count(point.reference_stamp_ns) == 0 ||
        target_.images->count(target_stamp) == 0) {
      return std::nullopt;
    }
    return PlaneTransfer{{source_.model.get(), &source_pose->second},
                         {target_.model.get(), &target_pose->second},
                         {point.point_in_map_m, point.normal_in_map}};
  }

  std::vector<Candidate> BestViews(int index, const std::vector<Timestamp>& stamps) const {
    constexpr double kSquareRadiusPx = 4.0;
    const FeaturePoint& point = source_.points[index];
    std::vector<std::pair<double, Timestamp>> ranked;
    std::optional<PlaneSamples> samples;
    for (const Timestamp stamp : stamps) {
      const auto transfer = TransferOf(point, stamp);
      if (!transfer) continue;
      if (!samples) samples = transfer->SamplesAround(point.reference_px, kSquareRadiusPx);
      if (!samples) return {};  // whatever the target is
      const auto warp = WarpInto(transfer->target, *samples, kSquareRadiusPx);
      if (!warp || warp->affine.determinant() <= 0.0) continue;
      const Eigen::Vector2d scales = ScalesOf(warp->affine);
      if (scales[0] > options_.max_scale || scales[1] < 1.0 / options_.max_scale) continue;
      ranked.emplace_back(std::hypot(std::log(scales[0]), std::log(scales[1])) + BlurOf(stamp),
                          stamp);
    }
    std::sort(ranked.begin(), ranked.end());
    const std::size_t count =
        std::min(ranked.size(), static_cast<std::size_t>(options_.max_views_per_point));
    std::vector<Candidate> candidates;
    for (std::size_t k = 0; k < count; ++k) candidates.emplace_back(index, ranked[k].second);
    return candidates;
  }

  /// How unlike the point's reference view an image is by its blur alone, on the scale of the
  /// change of scale that would blur as much.
  double BlurOf(Timestamp target_stamp) const {
    const auto found = target_.relative_sharpness.find(target_stamp);
    if (found == target_.relative_sharpness.end()) return 0.0;
    return std::max(0.0, std::log(kSharp / std::max(1e-3, found->second)));
  }

  bool IsOccluded(const PlaneTransfer& transfer, double target_row_px) const {
    const Eigen::Vector3d eye = transfer.target.pose->At(target_row_px).translation;
    const Eigen::Vector3d line = transfer.plane.point_in_map_m - eye;
    const double distance = line.norm();
    const auto hit = caster_.Cast({eye, line / distance}, kMaxRange_m);
    return hit && hit->range_m < distance - std::max(kOcclusionFloor_m, kOcclusionShare * distance);
  }

  /// True where the target's ray through a pixel meets the point's plane first, as far as the map
  /// knows.
  bool IsOnPlane(const PlaneTransfer& back, const Eigen::Vector2d& pixel) const {
    const auto ray = target_.model->Unproject(pixel);
    if (!ray) return false;
    const Rigid3 map_from_target = back.source.pose->At(pixel.y());
    const auto hit =
        caster_.Cast({map_from_target.translation, map_from_target.rotation * *ray}, kMaxRange_m);
    if (!hit) return false;
    const double off =
        std::abs(back.plane.normal_in_map.dot(hit->point_in_map_m - back.plane.point_in_map_m));
    return off < kOffPlane_m + kOffPlaneShare * hit->range_m;
  }

  /// Correlates the warped surroundings of the point with the target image. The warp is exact on a
  /// grid over the target's patch.
  Verdict FindPeak(const FeaturePoint& point, const PlaneTransfer& transfer, const PatchWarp& warp,
                   const cv::Mat& source_image, const cv::Mat& target_image,
                   CrossCameraMatch* match) const {
    const int half = (options_.patch_px / 2 + kGridStep - 1) / kGridStep * kGridStep;
    const cv::Point centre(static_cast<int>(std::lround(warp.center_px.x())),
                           static_cast<int>(std::lround(warp.center_px.y())));
    const int reach = half + options_.search_px;
    const cv::Rect window(centre.x - reach, centre.y - reach, 2 * reach + 1, 2 * reach + 1);
    if ((window & cv::Rect(cv::Point(0, 0), target_image.size())) != window) {
      return Verdict::kNotSeen;
    }
    // Target pixels to source pixels.
    const PlaneTransfer back{transfer.target, transfer.source, transfer.plane};
    cv::Mat1b mask;
    cv::Mat patch;
    const double share =
        WarpPatch(back, centre, half, source_image, ScalesOf(warp.affine).mean(), &patch, &mask);
    if (share < options_.min_plane_share) return Verdict::kOffPlane;
    const auto peak = Correlate(patch, mask, target_image(window));
    if (!peak || peak->ncc < options_.min_ncc) return Verdict::kUnlike;
    match->ncc = peak->ncc;
    match->peak_width_px = peak->width_px;
    // The patch was cut at whole target pixels: its centre shows the point's pixel but for the
    // rounding.
    match->correlation_px = warp.center_px + peak->shift_px;
    match->pixel = match->correlation_px;
    const double reference_border = 3.0 + options_.register_radius_px;
    if (point.reference_px.minCoeff() < reference_border) return Verdict::kUnregistered;
    if (peak->width_px > options_.max_peak_width_px ||
        peak->ncc - peak->second_ncc < options_.min_second_peak_gap) {
      return Verdict::kWide;
    }
    return Verdict::kMatched;
  }

  /// Fills patch and mask, (2 half + 1) square about a target pixel; returns the masked-in share.
  double WarpPatch(const PlaneTransfer& back, const cv::Point& centre, int half,
                   const cv::Mat& source_image, double target_px_per_source_px, cv::Mat* patch,
                   cv::Mat1b* mask) const {
    const int nodes = 2 * half / kGridStep + 1;
    cv::Mat2f grid(nodes, nodes, cv::Vec2f(-1e4F, -1e4F));
    cv::Mat1b on_plane(nodes, nodes, uchar{0});
    for (int v = 0; v < nodes; ++v) {
      for (int u = 0; u < nodes; ++u) {
        const Eigen::Vector2d pixel(centre.x - half + kGridStep * u,
                                    centre.y - half + kGridStep * v);
        const auto seen = back(pixel);
        if (!seen) continue;
        grid(v, u) = cv::Vec2f(static_cast<float>(seen->x()), static_cast<float>(seen->y()));
        // Rays are dear: every other node asks, the others follow their neighbour.
        on_plane(v, u) = u % kRayStep == 0 && v % kRayStep == 0
                             ? (IsOnPlane(back, pixel) ? 255 : 0)
                             : on_plane(v - v % kRayStep, u - u % kRayStep);
      }
    }
    const int edge = 2 * half + 1;
    cv::Mat2f map(edge, edge);
    mask->create(edge, edge);
    for (int y = 0; y < edge; ++y) {
      for (int x = 0; x < edge; ++x) {
        const int u = std::min(x / kGridStep, nodes - 2);
        const int v = std::min(y / kGridStep, nodes - 2);
        const float a = static_cast<float>(x - kGridStep * u) / kGridStep;
        const float b = static_cast<float>(y - kGridStep * v) / kGridStep;
        map(y, x) = (1 - b) * ((1 - a) * grid(v, u) + a * grid(v, u + 1)) +
                    b * ((1 - a) * grid(v + 1, u) + a * grid(v + 1, u + 1));
        const bool inside = map(y, x)[0] >= 0 && map(y, x)[1] >= 0 &&
                            map(y, x)[0] <= source_image.cols - 1 &&
                            map(y, x)[1] <= source_image.rows - 1;
        (*mask)(y, x) = inside ? on_plane(std::min((y + kGridStep / 2) / kGridStep, nodes - 1),
                                          std::min((x + kGridStep / 2) / kGridStep, nodes - 1))
                               : 0;
      }
    }
    *patch = SampleAt(source_image, map, 1.0 / target_px_per_source_px > kFinerScale);
    return static_cast<double>(cv::countNonZero(*mask)) / (edge * edge);
  }

  Verdict Refine(const FeaturePoint& point, const PatchWarp& predicted, const cv::Mat& source_image,
                 const cv::Mat& target_image, CrossCameraMatch* match) const {
    const auto patch = PatchTemplate::Create(source_image, point.reference_px,
                                             options_.register_radius_px, WarpFreedom::kShift);
    if (!patch) return Verdict::kUnregistered;
    PatchWarp start = predicted;
    start.center_px = match->correlation_px;
    PatchRegistrationLimits limits;
    limits.max_correction_px = options_.max_register_shift_px;
    const auto registered = patch->Register(target_image, start, limits);
    if (!registered || registered->ncc < options_.min_register_ncc) return Verdict::kUnregistered;
    match->pixel = registered->warp.center_px;
    match->covariance_px2 =
        options_.noise_correlation * registered->covariance_px2 +
        options_.sigma_floor_px * options_.sigma_floor_px * Eigen::Matrix2d::Identity();
    if (match->covariance_px2.trace() > options_.max_sigma_px * options_.max_sigma_px) {
      return Verdict::kUnregistered;
    }
    return Verdict::kMatched;
  }

  const MatchingCamera& source_;
  const MatchingCamera& target_;
  int source_index_;
  int target_index_;
  const RayCaster& caster_;
  const CrossCameraOptions& options_;
};

void Count(const Trial& trial, CrossCameraMatching* result) {
  switch (trial.verdict) {
    case Verdict::kNotSeen:
      break;
    case Verdict::kOccluded:
      ++result->num_occluded;
      break;
    case Verdict::kOffPlane:
      ++result->num_off_plane;
      break;
    case Verdict::kUnlike:
      ++result->num_unlike;
      break;
    case Verdict::kWide:
      ++result->num_wide;
      break;
    case Verdict::kUnregistered:
      ++result->num_unregistered;
      break;
    case Verdict::kMatched:
      result->matches.push_back(trial.match);
      break;
  }
}

}  // namespace

CrossCameraMatching MatchAcrossCameras(const std::vector<MatchingCamera>& cameras,
                                       const RayCaster& caster, const CrossCameraOptions& options) {
  CrossCameraMatching result;
  if (!options.enabled) return result;
  std::vector<FeaturePointGrid> grids;
  grids.reserve(cameras.size());
  for (const MatchingCamera& camera : cameras) grids.emplace_back(camera.points, options.radius_m);
  const int num_cameras = static_cast<int>(cameras.size());
  for (int source = 0; source < num_cameras; ++source) {
    for (int target = 0; target < num_cameras; ++target) {
      if (source == target) continue;
      const PairMatcher matcher(cameras, source, target, caster, options);
      const std::vector<Candidate> candidates = matcher.Candidates(grids[target]);
      std::vector<Trial> trials(candidates.size());
      tbb::parallel_for(tbb::blocked_range<std::size_t>(0, candidates.size(), 4),
                        [&](const tbb::blocked_range<std::size_t>& range) {
                          for (std::size_t i = range.begin(); i < range.end(); ++i) {
                            trials[i] = matcher.Match(candidates[i]);
                          }
                        });
      result.num_candidates += static_cast<int>(candidates.size());
      for (const Trial& trial : trials) Count(trial, &result);
    }
  }
  return result;
}

}  // namespace scenecalib
