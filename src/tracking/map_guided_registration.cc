#include "scenecalib/tracking/map_guided_registration.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

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

/// Third-order terms make a fit at the patch's border wrong inside; at 0.7 they balance.
constexpr double kSampleShare = 0.7;

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
    sample_radius_px_ = kSampleShare * radius_px;
    on_plane_ = SamplePlane({&model_, &pose->second}, plane_, reference_->pixel, sample_radius_px_,
                            kMinGrazingSine);
    if (!on_plane_) return false;
    patch_ =
        ReferencePatch::Create(image->second, reference_->pixel, radius_px, WarpFreedom::kShift);
    return patch_.has_value();
  }

  /// The warp at a time, by map and calibration; none where it says nothing useful.
  std::optional<PatchWarp> PredictWarp(Timestamp stamp_ns) const {
    const auto pose = poses_.find(stamp_ns);
    if (pose == poses_.end()) return std::nullopt;
    auto warp = WarpInto({&model_, &pose->second}, *on_plane_, sample_radius_px_);
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
  double sample_radius_px_ = 0.0;
  std::optional<PlaneSamples> on_plane_;
  std::optional<ReferencePatch> patch_;
  std::map<Timestamp, Found> found_;
  Eigen::Matrix2d covariance_sum_ = Eigen::Matrix2d::Zero();
};

}  // namespace

std::optional<PatchWarp> WarpThroughPlane(const CameraModel& model, const TrackPlane& plane,
                                          const ImagePose& reference,
                                          const Eigen::Vector2d& reference_px,
                                          const ImagePose& other, int radius_px) {
  const double half_edge_px = kSampleShare * radius_px;
  const auto samples =
      SamplePlane({&model, &reference}, plane, reference_px, half_edge_px, kMinGrazingSine);
  if (!samples) return std::nullopt;
  return WarpInto({&model, &other}, *samples, half_edge_px);
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
