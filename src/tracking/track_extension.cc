#include "scenecalib/tracking/track_extension.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <unordered_map>
#include <utility>

#include "scenecalib/tracking/scene_flow.h"

namespace scenecalib {
namespace {

/// Two tracks that come nearer than this in one image follow the same thing.
constexpr double kSameThingPx = 3.0;

struct Sighting {
  int track = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
};

/// A track on its way beyond one of its ends.
struct Runner {
  int track = 0;
  std::unique_ptr<ReferenceView> view;
  Eigen::Vector2d pixel;  ///< in the image before
  Eigen::Matrix2d affine_from_reference;
  int num_missed = 0;
};

/// Extends in one direction of time, image by image.
class Extender {
 public:
  Extender(const CameraModel& model, const std::map<Timestamp, cv::Mat>& images,
           const ReferenceMatcher& matcher, const TrackingOptions& options, bool forward,
           std::vector<RegisteredTrack>* tracks, ExtensionEvidence* evidence)
      : model_(model),
        matcher_(matcher),
        options_(options),
        forward_(forward),
        tracks_(*tracks),
        evidence_(*evidence) {
    for (const auto& [stamp_ns, image] : images) stamps_.push_back(stamp_ns);
    if (!forward_) std::reverse(stamps_.begin(), stamps_.end());
    std::map<Timestamp, std::size_t> image_of;
    for (std::size_t k = 0; k < stamps_.size(); ++k) image_of[stamps_[k]] = k;
    sightings_.resize(stamps_.size());
    ending_.resize(stamps_.size());
    for (int t = 0; t < static_cast<int>(tracks_.size()); ++t) {
      const auto& observations = tracks_[static_cast<std::size_t>(t)].track.observations;
      for (const TrackObservation& o : observations) {
        sightings_[image_of.at(o.stamp_ns)].push_back({t, o.pixel});
      }
      ending_[image_of.at(forward_ ? observations.back().stamp_ns : observations.front().stamp_ns)]
          .push_back(t);
    }
  }

  void Run() {
    std::optional<SceneFlow> flow;
    for (std::size_t k = 0; k + 1 < stamps_.size(); ++k) {
      Start(k);
      flow = EstimateFlow(k, flow);
      std::vector<std::optional<ReferenceMatch>> matches(runners_.size());
      tbb::parallel_for(tbb::blocked_range<std::size_t>(0, runners_.size(), 8),
                        [&](const tbb::blocked_range<std::size_t>& range) {
                          for (std::size_t r = range.begin(); r < range.end(); ++r) {
                            matches[r] = Step(flow, stamps_[k + 1], &runners_[r]);
                          }
                        });
      Settle(k + 1, matches);
    }
  }

 private:
  /// The tracks that end at an image set out.
  void Start(std::size_t k) {
    for (const int t : ending_[k]) {
      const RegisteredTrack& track = tracks_[static_cast<std::size_t>(t)];
      const auto& observations = track.track.observations;
      if (observations.empty()) continue;  // absorbed meanwhile
      const TrackObservation& end = forward_ ? observations.back() : observations.front();
      if (end.stamp_ns != stamps_[k]) continue;  // its end was taken over
      const TrackObservation& reference =
          observations[static_cast<std::size_t>(track.track.reference)];
      auto view = matcher_.Prepare(reference.stamp_ns, reference.pixel);
      if (!view) continue;
      runners_.push_back({t, std::make_unique<ReferenceView>(std::move(*view)), end.pixel,
                          forward_ ? track.last_from_reference : track.first_from_reference, 0});
    }
  }

  std::optional<SceneFlow> EstimateFlow(std::size_t k,
                                        const std::optional<SceneFlow>& before) const {
    std::unordered_map<int, Eigen::Vector2d> next;
    for (const Sighting& s : sightings_[k + 1]) next[s.track] = s.pixel;
    std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> pixels;
    for (const Sighting& s : sightings_[k]) {
      const auto found = next.find(s.track);
      if (found != next.end()) pixels.emplace_back(s.pixel, found->second);
    }
    const VerificationOptions& verification = options_.verification;
    return SceneFlow::Estimate(
        model_, pixels, verification.min_motion_px,
        {verification.ransac_iterations / 2, verification.max_epipolar_error_px, 1},
        before ? &*before : nullptr);
  }

  /// Moves a runner to where flow predicts it, and looks there.
  std::optional<ReferenceMatch> Step(const std::optional<SceneFlow>& flow, Timestamp stamp_ns,
                                     Runner* runner) const {
    if (flow) {
      const auto step = flow->Predict(runner->pixel);
      if (!step) {
        runner->num_missed = options_.flow.max_gap_images + 1;
        return std::nullopt;
      }
      runner->pixel = step->center_px;
      runner->affine_from_reference = step->affine * runner->affine_from_reference;
    }
    PatchWarp initial;
    initial.center_px = runner->pixel;
    initial.affine = runner->affine_from_reference;
    const auto match = ScaleChange(initial.affine) <= options_.registration.max_scale
                           ? matcher_.Match(runner->view.get(), initial, stamp_ns)
                           : std::nullopt;
    if (!match) {
      ++runner->num_missed;
      return std::nullopt;
    }
    runner->pixel = match->match.warp.center_px;
    runner->affine_from_reference = match->match.warp.affine;
    runner->num_missed = 0;
    return match;
  }

  /// Enters the matches into their tracks; where two tracks meet the longer one prevails.
  void Settle(std::size_t k, const std::vector<std::optional<ReferenceMatch>>& matches) {
    std::vector<Runner> kept;
    for (std::size_t r = 0; r < runners_.size(); ++r) {
      Runner& runner = runners_[r];
      if (runner.num_missed > options_.flow.max_gap_images) continue;
      RegisteredTrack& track = tracks_[static_cast<std::size_t>(runner.track)];
      if (track.track.observations.empty()) continue;
      if (matches[r]) {
        if (!TakeOver(k, runner)) continue;
        Enter(k, *matches[r], &track);
        sightings_[k].push_back({runner.track, runner.pixel});
        ++evidence_.num_observations_added;
      }
      kept.push_back(std::move(runner));
    }
    runners_ = std::move(kept);
  }

  /// False when a longer track is there already; takes a shorter one's sighting away.
  bool TakeOver(std::size_t k, const Runner& runner) {
    const std::size_t length =
        tracks_[static_cast<std::size_t>(runner.track)].track.observations.size();
    std::vector<std::size_t> met;
    for (std::size_t i = 0; i < sightings_[k].size(); ++i) {
      const Sighting& other = sightings_[k][i];
      if ((other.pixel - runner.pixel).squaredNorm() > kSameThingPx * kSameThingPx) continue;
      if (tracks_[static_cast<std::size_t>(other.track)].track.observations.size() >= length) {
        return false;
      }
      met.push_back(i);
    }
    for (auto i = met.rbegin(); i != met.rend(); ++i) {
      Remove(k, sightings_[k][*i].track);
      sightings_[k].erase(sightings_[k].begin() + static_cast<std::ptrdiff_t>(*i));
    }
    return true;
  }

  /// Takes one sighting out of a track; without its reference the whole track goes.
  void Remove(std::size_t k, int t) {
    Track& track = tracks_[static_cast<std::size_t>(t)].track;
    const auto found =
        std::find_if(track.observations.begin(), track.observations.end(),
                     [&](const TrackObservation& o) { return o.stamp_ns == stamps_[k]; });
    if (found == track.observations.end()) return;
    const auto index = static_cast<int>(found - track.observations.begin());
    if (index == track.reference || track.observations.size() == 1) {
      track.observations.clear();
      ++evidence_.num_tracks_absorbed;
      return;
    }
    track.observations.erase(found);
    if (index < track.reference) --track.reference;
  }

  void Enter(std::size_t k, const ReferenceMatch& found, RegisteredTrack* track) const {
    const PatchMatch& match = found.match;
    if (found.is_core) track->track.patch_radius_px = options_.registration.core_radius_px;
    const double floor = options_.registration.sigma_floor_px;
    TrackObservation observation;
    observation.stamp_ns = stamps_[k];
    observation.pixel = match.warp.center_px;
    // As ShareMatchCovariance: half of a match's covariance is the reference's.
    observation.covariance_px2 =
        0.5 * match.covariance_px2 + floor * floor * Eigen::Matrix2d::Identity();
    auto& observations = track->track.observations;
    if (forward_) {
      observations.push_back(observation);
      track->last_from_reference = match.warp.affine;
    } else {
      observations.insert(observations.begin(), observation);
      ++track->track.reference;
      track->first_from_reference = match.warp.affine;
    }
  }

  const CameraModel& model_;
  const ReferenceMatcher& matcher_;
  const TrackingOptions& options_;
  const bool forward_;
  std::vector<RegisteredTrack>& tracks_;
  ExtensionEvidence& evidence_;
  std::vector<Timestamp> stamps_;  ///< in the direction of extension
  std::vector<std::vector<Sighting>> sightings_;
  std::vector<std::vector<int>> ending_;  ///< tracks, by the image where they end
  std::vector<Runner> runners_;
};

}  // namespace

ExtensionEvidence ExtendTracks(const CameraModel& model, const std::map<Timestamp, cv::Mat>& images,
                               const cv::Mat& mask, const ImageQuality& quality,
                               const TrackingOptions& options,
                               std::vector<RegisteredTrack>* tracks) {
  ExtensionEvidence evidence;
  const ReferenceMatcher matcher(images, mask, quality, options.registration);
  const auto drop_short = [&] {
    const auto min_observations = static_cast<std::size_t>(options.verification.min_observations);
    tracks->erase(std::remove_if(tracks->begin(), tracks->end(),
                                 [&](const RegisteredTrack& track) {
                                   return track.track.observations.size() < min_observations;
                                 }),
                  tracks->end());
  };
  for (const bool forward : {false, true}) {
    Extender(model, images, matcher, options, forward, tracks, &evidence).Run();
    drop_short();
  }
  return evidence;
}

}  // namespace scenecalib
