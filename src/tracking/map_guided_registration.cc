#include "scenecalib/tracking/map_guided_registration.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <iterator>

#include "scenecalib/tracking/observation_noise.h"
#include "scenecalib/tracking/reference_registration.h"

namespace scenecalib {
namespace {

/// Rays that meet a plane flatter than this (sine of the angle to it) tell nothing.
constexpr double kMinGrazingSine = 0.02;

/// Offsets at which a warp is sampled, in units of the sampling radius.
constexpr int kNumSamples = 8;
constexpr double kSampleX[kNumSamples] = {-1, 0, 1, -1, 1, -1, 0, 1};
constexpr double kSampleY[kNumSamples] = {-1, -1, -1, 0, 0, 1, 1, 1};

/// Where the ray through a pixel meets the plane.
std::optional<Eigen::Vector3d> MeetPlane(const CameraModel& model, const TrackPlane& plane,
                                         const ImagePose& pose, const Eigen::Vector2d& pixel) {
  const auto ray = model.Unproject(pixel);
  if (!ray) return std::nullopt;
  const Rigid3 map_from_camera = pose.At(pixel.y());
  const Eigen::Vector3d ray_in_map = map_from_camera.rotation * *ray;
  const double sine = plane.normal_in_map.dot(ray_in_map);
  const double height = plane.normal_in_map.dot(plane.point_in_map_m - map_from_camera.translation);
  if (std::abs(sine) < kMinGrazingSine || height / sine <= 0.0) return std::nullopt;
  return Eigen::Vector3d(map_from_camera.translation + height / sine * ray_in_map);
}

/// Coefficients of the first and second order from the samples: least squares, factorised once.
Eigen::Matrix<double, 5, kNumSamples> MakeFit() {
  Eigen::Matrix<double, kNumSamples, 5> design;
  for (int i = 0; i < kNumSamples; ++i) {
    const double x = kSampleX[i];
    const double y = kSampleY[i];
    design.row(i) << x, y, x * x, x * y, y * y;
  }
  return (design.transpose() * design).inverse() * design.transpose();
}

/// The points of the plane that a reference patch shows: its centre and the samples around it.
struct PatchOnPlane {
  Eigen::Vector3d center_in_map_m;
  Eigen::Vector3d samples_in_map_m[kNumSamples];
  double sample_radius_px = 0.0;
};

std::optional<PatchOnPlane> LayOnPlane(const CameraModel& model, const TrackPlane& plane,
                                       const ImagePose& reference,
                                       const Eigen::Vector2d& reference_px, int radius_px) {
  PatchOnPlane patch;
  // Third-order terms make a fit at the patch's border wrong inside; at 0.7 they balance.
  patch.sample_radius_px = 0.7 * radius_px;
  const auto center = MeetPlane(model, plane, reference, reference_px);
  if (!center) return std::nullopt;
  patch.center_in_map_m = *center;
  for (int i = 0; i < kNumSamples; ++i) {
    const Eigen::Vector2d offset(kSampleX[i], kSampleY[i]);
    const auto sample =
        MeetPlane(model, plane, reference, reference_px + patch.sample_radius_px * offset);
    if (!sample) return std::nullopt;
    patch.samples_in_map_m[i] = *sample;
  }
  return patch;
}

std::optional<PatchWarp> SeeFrom(const CameraModel& model, const PatchOnPlane& patch,
                                 const ImagePose& other) {
  static const Eigen::Matrix<double, 5, kNumSamples> kFit = MakeFit();
  const auto center = other.Project(model, patch.center_in_map_m);
  if (!center) return std::nullopt;
  Eigen::Matrix<double, kNumSamples, 2> pixels;
  for (int i = 0; i < kNumSamples; ++i) {
    const auto pixel = other.Project(model, patch.samples_in_map_m[i]);
    if (!pixel) return std::nullopt;
    pixels.row(i) = (*pixel - *center).transpose();
  }
  const Eigen::Matrix<double, 5, 2> coefficients = kFit * pixels;
  const double r = patch.sample_radius_px;
  PatchWarp warp;
  warp.center_px = *center;
  warp.affine = coefficients.topRows<2>().transpose() / r;
  warp.quadratic = coefficients.bottomRows<3>().transpose() / (r * r);
  return warp;
}

/// Registers one track. The pieces are in the order of Run.
class GuidedTrack {
 public:
  GuidedTrack(const Track& track, const TrackPlane& plane, const CameraModel& model,
              const std::map<Timestamp, ImagePose>& poses,
              const std::map<Timestamp, cv::Mat>& images, const MapGuidedOptions& options)
      : track_(track),
        plane_(plane),
        model_(model),
        poses_(poses),
        images_(images),
        options_(options) {}

  /// The track anew; without observations when it had to be dropped.
  Track Run() {
    Track result;
    result.id = track_.id;
    result.patch_radius_px = track_.patch_radius_px;
    if (!Prepare()) return result;
    for (const TrackObservation& observation : track_.observations) {
      if (observation.stamp_ns == reference_->stamp_ns) {
        found_[observation.stamp_ns] = {reference_->pixel, reference_->pixel,
                                        Eigen::Matrix2d::Zero()};
      } else {
        Reregister(observation);
      }
    }
    if (static_cast<int>(found_.size()) >= options_.min_observations) {
      Extend(-1);
      Extend(+1);
      Collect(&result);
    }
    return result;
  }

 private:
  struct Found {
    Eigen::Vector2d pixel;
    Eigen::Vector2d predicted_px;  ///< by map and calibration alone
    Eigen::Matrix2d covariance_px2;
  };

  bool Prepare() {
    if (track_.observations.empty()) return false;
    reference_ = &track_.observations[track_.reference];
    const auto pose = poses_.find(reference_->stamp_ns);
    const auto image = images_.find(reference_->stamp_ns);
    if (pose == poses_.end() || image == images_.end()) return false;
    int radius_px = options_.radius_px;
    for (const int bound_px : {plane_.radius_px, track_.patch_radius_px}) {
      if (bound_px > 0) radius_px = std::min(radius_px, bound_px);
    }
    on_plane_ = LayOnPlane(model_, plane_, pose->second, reference_->pixel, radius_px);
    if (!on_plane_) return false;
    patch_ =
        ReferencePatch::Create(image->second, reference_->pixel, radius_px, WarpFreedom::kShift);
    return patch_.has_value();
  }

  /// The warp at a time, by map and calibration; none where it says nothing useful.
  std::optional<PatchWarp> PredictWarp(Timestamp stamp_ns) const {
    const auto pose = poses_.find(stamp_ns);
    if (pose == poses_.end()) return std::nullopt;
    auto warp = SeeFrom(model_, *on_plane_, pose->second);
    // A negative determinant sees the plane from behind.
    if (!warp || warp->affine.determinant() <= 0.0 ||
        ScaleChange(warp->affine) > options_.max_scale) {
      return std::nullopt;
    }
    return warp;
  }

  bool Match(Timestamp stamp_ns, const PatchWarp& predicted, const Eigen::Vector2d& start_px,
             double max_shift_px, double min_ncc) {
    const auto image = images_.find(stamp_ns);
    if (image == images_.end()) return false;
    PatchWarp initial = predicted;
    initial.center_px = start_px;
    const auto match = patch_->Register(
        image->second, initial, {options_.max_iterations, options_.convergence_px, max_shift_px});
    if (!match || match->ncc < min_ncc) return false;
    const Eigen::Matrix2d covariance = options_.noise_correlation * match->covariance_px2;
    if (!(covariance.trace() < options_.max_sigma_px * options_.max_sigma_px)) return false;
    const Eigen::Matrix2d to_reference = predicted.affine.inverse();
    covariance_sum_ += to_reference * covariance * to_reference.transpose();
    found_[stamp_ns] = {match->warp.center_px, predicted.center_px, covariance};
    return true;
  }

  /// A sighting of the tracker: the calibration may be off by pixels, the tracker is not, so its
  /// pixel is the start and only the warp's shape comes from the map.
  void Reregister(const TrackObservation& observation) {
    const auto predicted = PredictWarp(observation.stamp_ns);
    if (!predicted) return;
    Match(observation.stamp_ns, *predicted, observation.pixel, options_.max_shift_px,
          options_.min_ncc);
  }

  /// Walks from the first or last sighting into images where the tracker had none. What map and
  /// calibration mispredicted in the sighting next in time is carried along.
  void Extend(int direction) {
    const Found* neighbour = direction > 0 ? &found_.rbegin()->second : &found_.begin()->second;
    auto pose = poses_.find(direction > 0 ? found_.rbegin()->first : found_.begin()->first);
    for (int i = 0; i < options_.max_extension; ++i) {
      if (direction < 0 && pose == poses_.begin()) return;
      direction > 0 ? ++pose : --pose;
      if (pose == poses_.end()) return;
      const auto predicted = PredictWarp(pose->first);
      if (!predicted) return;
      const Eigen::Vector2d start_px =
          predicted->center_px + (neighbour->pixel - neighbour->predicted_px);
      if (!Match(pose->first, *predicted, start_px, options_.max_extension_shift_px,
                 options_.min_extension_ncc)) {
        return;
      }
      neighbour = &found_[pose->first];
    }
  }

  void Collect(Track* result) const {
    for (const auto& [stamp_ns, found] : found_) {
      if (stamp_ns == reference_->stamp_ns) {
        result->reference = static_cast<int>(result->observations.size());
      }
      result->observations.push_back({stamp_ns, found.pixel, found.covariance_px2});
    }
    ShareMatchCovariance(covariance_sum_ / static_cast<double>(found_.size() - 1),
                         options_.sigma_floor_px, result);
  }

  const Track& track_;
  const TrackPlane& plane_;
  const CameraModel& model_;
  const std::map<Timestamp, ImagePose>& poses_;
  const std::map<Timestamp, cv::Mat>& images_;
  const MapGuidedOptions& options_;

  const TrackObservation* reference_ = nullptr;
  std::optional<PatchOnPlane> on_plane_;
  std::optional<ReferencePatch> patch_;
  std::map<Timestamp, Found> found_;
  Eigen::Matrix2d covariance_sum_ = Eigen::Matrix2d::Zero();
};

}  // namespace

std::optional<PatchWarp> WarpThroughPlane(const CameraModel& model, const TrackPlane& plane,
                                          const ImagePose& reference,
                                          const Eigen::Vector2d& reference_px,
                                          const ImagePose& other, int radius_px) {
  const auto patch = LayOnPlane(model, plane, reference, reference_px, radius_px);
  if (!patch) return std::nullopt;
  return SeeFrom(model, *patch, other);
}

MapGuidedTracks RegisterThroughMap(const std::vector<Track>& tracks,
                                   const std::vector<TrackPlane>& planes, const CameraModel& model,
                                   const std::map<Timestamp, ImagePose>& poses,
                                   const std::map<Timestamp, cv::Mat>& images,
                                   const MapGuidedOptions& options) {
  MapGuidedTracks result;
  result.tracks.resize(tracks.size());
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, tracks.size(), 16),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t i = range.begin(); i < range.end(); ++i) {
                        result.tracks[i] =
                            GuidedTrack(tracks[i], planes[i], model, poses, images, options).Run();
                      }
                    });
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    const auto& before = tracks[i].observations;
    const auto& after = result.tracks[i].observations;
    if (after.empty()) {
      ++result.num_tracks_dropped;
      continue;
    }
    const auto num_kept = static_cast<int>(
        std::count_if(after.begin(), after.end(), [&before](const TrackObservation& observation) {
          return std::any_of(before.begin(), before.end(), [&](const TrackObservation& other) {
            return other.stamp_ns == observation.stamp_ns;
          });
        }));
    result.num_observations_dropped += static_cast<int>(before.size()) - num_kept;
    result.num_observations_added += static_cast<int>(after.size()) - num_kept;
  }
  return result;
}

}  // namespace scenecalib
