#include "scenecalib/tracking/live_tracker.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "feature_prediction.h"
#include "pixel_mask.h"
#include "scenecalib/tracking/track_verification.h"

namespace scenecalib {
namespace {

/// Images after which a feature's motion is compared with its neighbours' (FindFixedToVehicle).
constexpr std::size_t kStaticWindow = 8;
/// New features keep off this far from something fixed to the vehicle.
constexpr int kFixedMarginPx = 7;
/// The check for what is fixed to the vehicle looks back over many images: it need not be made
/// often.
constexpr int kFixedCheckPeriod = 4;
/// Images for which the place of a patch that straddles an edge is remembered.
constexpr int kEdgeMemory = 8;
/// Noise of a bilinear reading as a share of the pixels' own.
constexpr double kBilinearNoise = 0.8;
/// How far from its prediction by scene flow a lost feature is looked for.
constexpr double kMaxRescueShiftPx = 10.0;
/// Levels of the pyramid above the finest one that are searched where the motion is expected to go
/// on.
constexpr int kNearLevels = 1;
/// Share of the features that may be lost there before a sample of them, one in kFarSample, is
/// looked for farther away, and share of the sample that has to be found before the others are too.
constexpr double kMaxLostShare = 0.4;
constexpr std::size_t kFarSample = 10;
constexpr double kMinFarShare = 0.08;
/// A live track needs no final precision.
constexpr double kLiveConvergencePx = 0.08;
/// Mean grey value and its deviation below which there is nothing to detect.
constexpr double kBlackMean = 3.0;
constexpr double kBlackDeviation = 2.0;

/// Pixels that the model covers and the mask (if any) lets see, away from their border by
/// `margin_px`.
cv::Mat MakeDomainMask(const CameraModel& model, const cv::Mat& seen, int margin_px) {
  cv::Mat mask(model.height_px(), model.width_px(), CV_8UC1, cv::Scalar(0));
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) {
      if (model.Unproject({static_cast<double>(x), static_cast<double>(y)})) {
        mask.at<uchar>(y, x) = 255;
      }
    }
  }
  if (!seen.empty()) mask.setTo(0, seen == 0);
  const int edge = 2 * margin_px + 1;
  cv::erode(mask, mask, cv::getStructuringElement(cv::MORPH_RECT, {edge, edge}), {-1, -1}, 1,
            cv::BORDER_CONSTANT, cv::Scalar(0));
  return mask;
}

template <typename Body>
void ForEach(std::size_t size, const Body& body) {
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, size, 32),
                    [&](const tbb::blocked_range<std::size_t>& range) {
                      for (std::size_t i = range.begin(); i < range.end(); ++i) body(i);
                    });
}

}  // namespace

LiveTracker::LiveTracker(CameraModelPtr model, const TrackingOptions& options, const cv::Mat& seen)
    : model_(std::move(model)),
      options_(options),
      domain_(MakeDomainMask(*model_, seen, options_.registration.live_radius_px + 2)),
      allowed_(domain_.clone()),
      open_(allowed_),
      static_regions_(domain_, options_.static_regions),
      new_features_(ForFieldOfView(options_.detection, model_->max_theta_rad())) {}

FrameTracking LiveTracker::Add(const GrayImage& image) {
  num_finished_before_ = finished_.size();
  FrameTracking frame;
  frame.stamp_ns = image.stamp_ns;
  const ImageQuality quality = MeasureImageQuality(image.pixels, domain_);
  frame.mean_brightness = quality.mean;
  frame.is_black = quality.mean < kBlackMean && quality.contrast < kBlackDeviation;
  const RegistrationOptions& registration = options_.registration;
  noise_levels_ = kBilinearNoise * quality.noise_levels;
  max_residual_levels_ = std::hypot(registration.max_residual_noise * noise_levels_,
                                    registration.max_residual_contrast * quality.contrast);

  const bool is_first = previous_image_.empty();
  const bool equalise = quality.mean < options_.flow.dark_mean;
  if (equalise != previous_equalised_ && !is_first) {
    // Both images of a pair must have been treated alike.
    previous_pyramid_ = BuildFlowPyramid(previous_image_, equalise, options_.flow);
  }
  FlowPyramid pyramid = BuildFlowPyramid(image.pixels, equalise, options_.flow);
  if (!is_first) Follow(image, pyramid, &frame);
  RemoveDuplicates(pyramid.scale(), &frame);
  if (++num_images_ % kFixedCheckPeriod == 0) {
    const bool is_allowed_changed = RemoveFixed(&frame);
    RemoveStatic(pyramid, is_allowed_changed, &frame);
  }
  frame.num_tracked =
      static_cast<int>(std::count_if(active_.begin(), active_.end(), [](const ActiveTrack& track) {
        return track.num_missed == 0;
      }));
  if (!frame.is_black) Detect(image, pyramid, &frame);

  previous_image_ = image.pixels;
  previous_pyramid_ = std::move(pyramid);
  previous_equalised_ = equalise;
  before_previous_stamp_ns_ = is_first ? image.stamp_ns : previous_stamp_ns_;
  previous_stamp_ns_ = image.stamp_ns;
  return frame;
}

std::vector<std::size_t> LiveTracker::Search(const GrayImage& image, const FlowPyramid& pyramid,
                                             int num_levels,
                                             const std::vector<FeaturePrediction>& predicted,
                                             const std::vector<std::size_t>& features) {
  std::vector<Eigen::Vector2d> before, expected;
  for (const std::size_t i : features) {
    before.push_back(active_[i].place.pixel);
    expected.push_back(predicted[i].pixel);
  }
  const auto flow =
      FlowThereAndBack(previous_pyramid_, pyramid, before, expected, num_levels, options_.flow);
  std::vector<char> is_extended(features.size(), 0);
  ForEach(features.size(), [&](std::size_t k) {
    if (!flow[k]) return;
    const std::size_t i = features[k];
    const FeaturePrediction found{*flow[k], predicted[i].affine_from_first};
    is_extended[k] = Extend(image, found, options_.registration.min_live_ncc, &active_[i]) ? 1 : 0;
  });
  std::vector<std::size_t> lost;
  for (std::size_t k = 0; k < features.size(); ++k) {
    if (is_extended[k] == 0) lost.push_back(features[k]);
  }
  return lost;
}

void LiveTracker::Follow(const GrayImage& image, const FlowPyramid& pyramid, FrameTracking* frame) {
  const std::vector<FeaturePrediction> predicted =
      PredictFeatures(active_, scene_flow_ ? &*scene_flow_ : nullptr,
                      {before_previous_stamp_ns_, previous_stamp_ns_, image.stamp_ns});
  std::vector<char> is_extended(active_.size(), 0);
  std::vector<std::size_t> followed;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    // What is about to leave the image need not be looked for.
    if (active_[i].num_missed > 0 || !IsSet(domain_, predicted[i].pixel)) continue;
    followed.push_back(i);
    is_extended[i] = 1;
  }
  const bool is_near = scene_flow_.has_value() && kNearLevels < options_.flow.pyramid_levels;
  const int num_levels = is_near ? kNearLevels : options_.flow.pyramid_levels;
  std::vector<std::size_t> lost = Search(image, pyramid, num_levels, predicted, followed);
  if (is_near &&
      static_cast<double>(lost.size()) > kMaxLostShare * static_cast<double>(followed.size())) {
    // Perhaps they did not go where they were expected.
    std::vector<std::size_t> sample, others;
    for (std::size_t k = 0; k < lost.size(); ++k) {
      (k % kFarSample == 0 ? sample : others).push_back(lost[k]);
    }
    const std::vector<std::size_t> lost_of_sample =
        Search(image, pyramid, options_.flow.pyramid_levels, predicted, sample);
    if (static_cast<double>(sample.size() - lost_of_sample.size()) >=
        kMinFarShare * static_cast<double>(sample.size())) {
      others = Search(image, pyramid, options_.flow.pyramid_levels, predicted, others);
    }
    lost = std::move(others);
    lost.insert(lost.end(), lost_of_sample.begin(), lost_of_sample.end());
  }
  for (const std::size_t i : lost) is_extended[i] = 0;
  Learn(pyramid, is_extended);
  EstimateSceneFlow(is_extended);
  std::vector<char> is_kept = is_extended;
  ForEach(active_.size(), [&](std::size_t i) {
    if (is_extended[i] == 0) is_kept[i] = FindAgain(image, pyramid, &active_[i]) ? 1 : 0;
  });
  frame->num_rejected += EndOthers(is_kept, false);
}

/// Looks for a lost feature where scene flow predicts it; where that fails too the prediction is
/// its place until the next image. False when the track has to be given up.
bool LiveTracker::FindAgain(const GrayImage& image, const FlowPyramid& pyramid,
                            ActiveTrack* active_track) const {
  if (!scene_flow_) return false;
  const auto step = scene_flow_->Predict(active_track->place.pixel);
  if (!step || !IsSet(domain_, step->center_px)) return false;
  const FeaturePrediction predicted{step->center_px,
                                    step->affine * active_track->place.affine_from_first};
  if (!active_track->straddles_edge) {
    if (active_track->num_missed == 0
            ? Rescue(image, pyramid, *step, active_track)
            : Extend(image, predicted, options_.registration.min_ncc, active_track)) {
      return true;
    }
  }
  active_track->place = {image.stamp_ns, predicted.pixel, predicted.affine_from_first};
  ++active_track->num_missed;
  if (active_track->straddles_edge) return active_track->num_missed <= kEdgeMemory;
  return active_track->num_missed <= options_.flow.max_gap_images &&
         active_track->track.observations.size() >= 2;
}

/// Registers one feature against its patch; false when the track ends here.
bool LiveTracker::Extend(const GrayImage& image, const FeaturePrediction& predicted, double min_ncc,
                         ActiveTrack* active_track) const {
  const RegistrationOptions& registration = options_.registration;
  PatchWarp initial;
  initial.center_px = predicted.pixel;
  initial.affine = predicted.affine_from_first * active_track->patch_affine_from_first.inverse();
  const PatchRegistrationLimits limits{registration.max_iterations, kLiveConvergencePx,
                                       registration.max_correction_px};
  const auto match = active_track->patch.Register(image.pixels, initial, limits);
  if (!match || match->ncc < min_ncc * ReachableNcc(match->reference_sigma, noise_levels_) ||
      !IsSet(domain_, match->warp.center_px))
    return false;
  if (match->residual_sigma > max_residual_levels_ * std::hypot(1.0, match->gain)) {
    active_track->straddles_edge = true;
    return false;
  }
  LiveObservation observation;
  observation.stamp_ns = image.stamp_ns;
  observation.pixel = match->warp.center_px;
  observation.affine_from_first = match->warp.affine * active_track->patch_affine_from_first;
  if (ScaleChange(match->warp.affine) > registration.max_live_scale) {
    // Drift that this brings is undone by the final registration against one reference.
    auto patch = PatchTemplate::Create(image.pixels, observation.pixel, registration.live_radius_px,
                                       WarpFreedom::kAffine, PatchReading::kBilinear);
    if (!patch) return false;
    active_track->patch = std::move(*patch);
    active_track->patch_affine_from_first = observation.affine_from_first;
  }
  active_track->track.observations.push_back(observation);
  active_track->place = observation;
  active_track->num_missed = 0;
  return true;
}

/// From the tracks that reached the newest image.
void LiveTracker::EstimateSceneFlow(const std::vector<char>& is_extended) {
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> pixels;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const auto& observations = active_[i].track.observations;
    if (is_extended[i] == 0 ||
        observations[observations.size() - 2].stamp_ns != previous_stamp_ns_) {
      continue;
    }
    pixels.emplace_back(observations[observations.size() - 2].pixel, observations.back().pixel);
  }
  const VerificationOptions& verification = options_.verification;
  const std::optional<SceneFlow> before = std::move(scene_flow_);
  scene_flow_ = SceneFlow::Estimate(
      *model_, pixels, verification.min_motion_px,
      {verification.ransac_iterations / 2, verification.max_epipolar_error_px, 1},
      before ? &*before : nullptr);
}

/// Finds by scene flow what the search did not: first the shift on the reduced image, where it may
/// be large, against the previous image; then Extend.
bool LiveTracker::Rescue(const GrayImage& image, const FlowPyramid& pyramid, const PatchWarp& step,
                         ActiveTrack* active_track) const {
  const LiveObservation& last = active_track->place;
  FeaturePrediction predicted{step.center_px, step.affine * last.affine_from_first};
  if (pyramid.base_level > 0) {
    const double scale = pyramid.scale();
    const auto patch = PatchTemplate::Create(previous_pyramid_.base(), last.pixel / scale,
                                             options_.registration.live_radius_px,
                                             WarpFreedom::kShift, PatchReading::kBilinear);
    if (!patch) return false;
    PatchWarp reduced = step;
    reduced.center_px /= scale;
    const auto match =
        patch->Register(pyramid.base(), reduced,
                        {options_.registration.max_iterations, 0.05, kMaxRescueShiftPx / scale});
    if (!match || match->ncc < options_.registration.min_live_ncc *
                                   ReachableNcc(match->reference_sigma, noise_levels_)) {
      return false;
    }
    predicted.pixel = scale * match->warp.center_px;
  }
  return Extend(image, predicted, options_.registration.min_live_ncc, active_track);
}

/// Of two tracks that ran into each other the one with the shorter history ends.
void LiveTracker::RemoveDuplicates(double scale, FrameTracking* frame) {
  std::vector<std::size_t> order;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    if (active_[i].num_missed == 0) order.push_back(i);
  }
  std::stable_sort(order.begin(), order.end(), [this](std::size_t a, std::size_t b) {
    return active_[a].track.observations.size() > active_[b].track.observations.size();
  });
  cv::Mat taken(static_cast<int>(domain_.rows / scale) + 1,
                static_cast<int>(domain_.cols / scale) + 1, CV_8UC1, cv::Scalar(0));
  const Disc near(
      std::max(1, static_cast<int>(std::lround(options_.flow.merge_distance_px / scale))));
  std::vector<char> is_kept(active_.size(), 1);
  for (std::size_t i : order) {
    const Eigen::Vector2d pixel = active_[i].place.pixel / scale;
    if (IsSet(taken, pixel)) {
      is_kept[i] = 0;
      active_[i].track.observations.pop_back();  // this sighting belongs to the other track
    } else {
      near.Fill(ToPoint(pixel), 255, &taken);
    }
  }
  frame->num_rejected += EndOthers(is_kept, false);
}

/// Ends and forgets what is fixed to the vehicle, and keeps new features off it; true when anything
/// was.
bool LiveTracker::RemoveFixed(FrameTracking* frame) {
  std::vector<FeatureMotion> motions;
  std::vector<std::size_t> judged;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const auto& observations = active_[i].track.observations;
    if (observations.size() < kStaticWindow || active_[i].num_missed > 0) continue;
    const std::size_t first = observations.size() - kStaticWindow;
    FeatureMotion motion;
    motion.pixel = observations.back().pixel;
    motion.duration_s = SecondsBetween(observations[first].stamp_ns, observations.back().stamp_ns);
    for (std::size_t k = first; k < observations.size(); ++k) {
      motion.extent_px = std::max(motion.extent_px, (observations[k].pixel - motion.pixel).norm());
    }
    motions.push_back(motion);
    judged.push_back(i);
  }
  const std::vector<bool> is_fixed = FindFixedToVehicle(motions, options_.verification);
  std::vector<char> is_kept(active_.size(), 1);
  for (std::size_t k = 0; k < judged.size(); ++k) {
    if (!is_fixed[k]) continue;
    is_kept[judged[k]] = 0;
    cv::circle(allowed_, ToPoint(motions[k].pixel), kFixedMarginPx, cv::Scalar(0), cv::FILLED);
  }
  const int num_removed = EndOthers(is_kept, true);
  frame->num_rejected += num_removed;
  return num_removed > 0;
}

/// Ends tracks where they come into regions that never move, and keeps new features off those.
void LiveTracker::RemoveStatic(const FlowPyramid& pyramid, bool is_allowed_changed,
                               FrameTracking* frame) {
  const bool is_changed =
      static_regions_.Add(pyramid, scene_flow_ ? &*scene_flow_ : nullptr, kFixedCheckPeriod);
  const cv::Mat& mask = static_regions_.mask();
  if (is_changed || is_allowed_changed) {
    open_ = allowed_;
    if (!mask.empty()) {
      open_ = allowed_.clone();
      open_.setTo(0, mask);
    }
  }
  if (mask.empty()) return;
  std::vector<char> is_kept(active_.size());
  for (std::size_t i = 0; i < active_.size(); ++i) {
    is_kept[i] = IsSet(mask, active_[i].place.pixel) ? 0 : 1;
  }
  frame->num_rejected += EndOthers(is_kept, false);
}

void LiveTracker::Learn(const FlowPyramid& pyramid, const std::vector<char>& is_extended) {
  std::vector<FeatureTrial> trials;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const auto& observations = active_[i].track.observations;
    const bool is_followed = is_extended[i] != 0;
    if (observations.size() - (is_followed ? 1 : 0) != 1 || active_[i].num_missed > 0) continue;
    trials.push_back({observations.front().pixel, is_followed});
  }
  new_features_.Learn(pyramid, trials);
}

void LiveTracker::Detect(const GrayImage& image, const FlowPyramid& pyramid, FrameTracking* frame) {
  FeatureSurroundings surroundings;
  surroundings.domain = domain_;
  surroundings.allowed = open_;
  for (const ActiveTrack& track : active_) {
    if (track.num_missed == 0) surroundings.live.push_back(track.place.pixel);
    if (track.straddles_edge) surroundings.avoided.push_back(track.place.pixel);
  }
  surroundings.avoided_radius_px = options_.registration.live_radius_px;
  if (scene_flow_) surroundings.flow = &*scene_flow_;
  for (const Eigen::Vector2d& pixel : new_features_.Find(pyramid, surroundings)) {
    auto patch = PatchTemplate::Create(image.pixels, pixel, options_.registration.live_radius_px,
                                       WarpFreedom::kAffine, PatchReading::kBilinear);
    if (!patch) continue;
    ActiveTrack track{{}, std::move(*patch), Eigen::Matrix2d::Identity(), {}, 0, false};
    track.place = {image.stamp_ns, pixel, Eigen::Matrix2d::Identity()};
    track.track.id = next_id_++;
    track.track.observations.push_back(track.place);
    active_.push_back(std::move(track));
    ++frame->num_new;
  }
}

}  // namespace scenecalib
