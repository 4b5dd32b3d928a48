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

/// Change of scale against its view from which a runner may take a nearer view.
constexpr double kMinScaleOfNewView = 1.4;

/// Views that a runner may take after its track's reference: each adds its error.
constexpr int kMaxNewViews = 3;

/// A sighting that can serve as the view to compare further ones with.
struct Sight {
  Timestamp stamp_ns = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Matrix2d affine_from_view = Eigen::Matrix2d::Identity();
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Zero();
};

/// A track on its way beyond one of its ends.
struct Runner {
  int track = 0;
  std::unique_ptr<ReferenceView> view;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();  ///< in the image before
  Eigen::Matrix2d affine_from_view = Eigen::Matrix2d::Identity();
  int num_missed = 0;
  Eigen::Matrix2d view_from_reference = Eigen::Matrix2d::Identity();  ///< affine
  Eigen::Matrix2d view_covariance_px2 = Eigen::Matrix2d::Zero();      ///< of what it is centred on
  int num_new_views = 0;
  std::optional<Sight> last;  ///< the newest sighting by the whole patch
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
      Runner runner;
      runner.track = t;
      runner.view = std::make_unique<ReferenceView>(std::move(*view));
      runner.pixel = end.pixel;
      runner.affine_from_view = forward_ ? track.last_from_reference : track.first_from_reference;
      if (track.track.patch_radius_px != options_.registration.core_radius_px) {
        runner.last = Sight{end.stamp_ns, end.pixel, runner.affine_from_view, end.covariance_px2};
      }
      runners_.push_back(std::move(runner));
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
      runner->affine_from_view = step->affine * runner->affine_from_view;
    }
    auto match = Look(stamp_ns, runner);
    if (!match && TakeNewView(runner)) match = Look(stamp_ns, runner);
    if (!match) {
      ++runner->num_missed;
      return std::nullopt;
    }
    runner->pixel = match->match.warp.center_px;
    runner->affine_from_view = match->match.warp.affine;
    runner->num_missed = 0;
    if (!match->is_core) {
      runner->last = Sight{stamp_ns, runner->pixel, runner->affine_from_view,
                           Covariance(match->match, *runner)};
    }
    return match;
  }

  std::optional<ReferenceMatch> Look(Timestamp stamp_ns, Runner* runner) const {
    PatchWarp initial;
    initial.center_px = runner->pixel;
    initial.affine = runner->affine_from_view;
    if (ScaleChange(initial.affine) > options_.registration.max_scale) return std::nullopt;
    return matcher_.Match(runner->view.get(), initial, stamp_ns);
  }

  /// From the newest sighting on, where the scale has changed against the view: what no longer
  /// looks like that may still look like this. Elsewhere a patch that no longer matches straddles
  /// an edge, and would only slide along with it.
  bool TakeNewView(Runner* runner) const {
    const double max_sigma_px = options_.registration.max_view_sigma_px;
    if (!runner->last || runner->num_new_views == kMaxNewViews ||
        runner->last->covariance_px2.trace() > max_sigma_px * max_sigma_px ||
        ScaleChange(runner->last->affine_from_view) < kMinScaleOfNewView) {
      return false;
    }
    auto view = matcher_.Prepare(runner->last->stamp_ns, runner->last->pixel);
    if (!view) return false;
    *runner->view = std::move(*view);
    runner->affine_from_view = runner->affine_from_view * runner->last->affine_from_view.inverse();
    runner->view_from_reference = runner->last->affine_from_view * runner->view_from_reference;
    runner->view_covariance_px2 = runner->last->covariance_px2;
    runner->last.reset();
    ++runner->num_new_views;
    return true;
  }

  /// Of a sighting about the reference's point. As ShareMatchCovariance: half of a match's
  /// covariance is the view's; beyond the reference the view's place is not certain either.
  Eigen::Matrix2d Covariance(const PatchMatch& match, const Runner& runner) const {
    const double floor = options_.registration.sigma_floor_px;
    const Eigen::Matrix2d& affine = match.warp.affine;
    return (runner.num_new_views > 0 ? 1.0 : 0.5) * match.covariance_px2 +
           floor * floor * Eigen::Matrix2d::Identity() +
           affine * runner.view_covariance_px2 * affine.transpose();
  }

  /// Whether a track that goes on to this match still tells its two ends apart from each other: the
  /// far end's uncertainty, as large as the near end sees it, stays within the limit.
  bool HoldsTogether(const PatchMatch& match, const Runner& runner,
                     const RegisteredTrack& track) const {
    const double max_sigma_px = options_.registration.max_end_sigma_px;
    const auto& observations = track.track.observations;
    const TrackObservation& other = forward_ ? observations.front() : observations.back();
    const Eigen::Matrix2d other_from_reference =
        forward_ ? track.first_from_reference : track.last_from_reference;
    const Eigen::Matrix2d from_other =
        match.warp.affine * runner.view_from_reference * other_from_reference.inverse();
    const Eigen::Matrix2d to_other = from_other.inverse();
    const Eigen::Matrix2d here = Covariance(match, runner);
    const double squared_px2 =
        std::max((from_other * other.covariance_px2 * from_other.transpose()).trace(),
                 (to_other * here * to_other.transpose()).trace());
    return squared_px2 <= max_sigma_px * max_sigma_px;
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
        if (!HoldsTogether(matches[r]->match, runner, track)) continue;
        if (!TakeOver(k, runner)) continue;
        Enter(k, *matches[r], runner, &track);
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

  void Enter(std::size_t k, const ReferenceMatch& found, const Runner& runner,
             RegisteredTrack* track) const {
    if (found.is_core) track->track.patch_radius_px = options_.registration.core_radius_px;
    const PatchMatch& match = found.match;
    const TrackObservation observation{stamps_[k], match.warp.center_px, Covariance(match, runner)};
    const Eigen::Matrix2d from_reference = match.warp.affine * runner.view_from_reference;
    auto& observations = track->track.observations;
    if (forward_) {
      observations.push_back(observation);
      track->last_from_reference = from_reference;
    } else {
      observations.insert(observations.begin(), observation);
      ++track->track.reference;
      track->first_from_reference = from_reference;
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
