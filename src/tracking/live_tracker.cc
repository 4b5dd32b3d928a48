#include "scenecalib/tracking/live_tracker.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "scenecalib/tracking/feature_detector.h"
#include "scenecalib/tracking/track_verification.h"

namespace scenecalib {
namespace {

/// Images after which a feature's motion is compared with its neighbours' (FindFixedToVehicle).
constexpr std::size_t kStaticWindow = 8;
/// New features keep off this far from something fixed to the vehicle.
constexpr int kFixedMarginPx = 7;
/// Two live tracks nearer than this follow the same thing: the younger ends.
constexpr int kMergeDistancePx = 4;
/// How far from its prediction by scene flow a lost feature is looked for.
constexpr double kMaxRescueShiftPx = 10.0;
/// A live track needs no final precision: its convergence against that of the last registration.
constexpr double kLiveConvergence = 8.0;
/// Mean grey value and its deviation below which there is nothing to detect.
constexpr double kBlackMean = 3.0;
constexpr double kBlackDeviation = 2.0;

/// Pixels that the model covers, away from its border by `margin_px`.
cv::Mat MakeDomainMask(const CameraModel& model, int margin_px) {
  cv::Mat mask(model.height_px(), model.width_px(), CV_8UC1, cv::Scalar(0));
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) {
      if (model.Unproject({static_cast<double>(x), static_cast<double>(y)})) {
        mask.at<uchar>(y, x) = 255;
      }
    }
  }
  const int edge = 2 * margin_px + 1;
  cv::erode(mask, mask, cv::getStructuringElement(cv::MORPH_RECT, {edge, edge}), {-1, -1}, 1,
            cv::BORDER_CONSTANT, cv::Scalar(0));
  return mask;
}

bool IsSet(const cv::Mat& mask, const Eigen::Vector2d& pixel) {
  const auto x = std::lround(pixel.x());
  const auto y = std::lround(pixel.y());
  return x >= 0 && y >= 0 && x < mask.cols && y < mask.rows &&
         mask.at<uchar>(static_cast<int>(y), static_cast<int>(x)) != 0;
}

cv::Point2f ToPoint(const Eigen::Vector2d& pixel) {
  return {static_cast<float>(pixel.x()), static_cast<float>(pixel.y())};
}

}  // namespace

LiveTracker::LiveTracker(CameraModelPtr model, const TrackingOptions& options)
    : model_(std::move(model)),
      options_(options),
      domain_(MakeDomainMask(*model_, options_.registration.live_radius_px + 2)),
      fixed_(domain_.size(), CV_8UC1, cv::Scalar(0)) {}

FrameTracking LiveTracker::Add(const GrayImage& image) {
  FrameTracking frame;
  frame.stamp_ns = image.stamp_ns;
  cv::Scalar mean, deviation;
  cv::meanStdDev(image.pixels, mean, deviation);
  frame.mean_brightness = mean[0];
  frame.is_black = mean[0] < kBlackMean && deviation[0] < kBlackDeviation;

  const bool is_first = previous_image_.empty();
  const bool equalise = mean[0] < options_.flow.dark_mean;
  if (equalise != previous_equalised_ && !is_first) {
    // Both images of a pair must have been treated alike.
    previous_pyramid_ = BuildFlowPyramid(previous_image_, equalise, options_.flow);
  }
  FlowPyramid pyramid = BuildFlowPyramid(image.pixels, equalise, options_.flow);
  if (!is_first) Follow(image, pyramid, &frame);
  RemoveDuplicates(&frame);
  RemoveFixed(&frame);
  frame.num_tracked = static_cast<int>(active_.size());
  if (!frame.is_black) Detect(image, pyramid.front(), &frame);

  previous_image_ = image.pixels;
  previous_pyramid_ = std::move(pyramid);
  previous_equalised_ = equalise;
  before_previous_stamp_ns_ = is_first ? image.stamp_ns : previous_stamp_ns_;
  previous_stamp_ns_ = image.stamp_ns;
  return frame;
}

/// Motion under perspective grows geometrically as things come nearer, so the last step is repeated
/// with its own growth; a feature without history borrows its neighbours' motion.
std::vector<LiveTracker::Prediction> LiveTracker::Predict(Timestamp stamp_ns) const {
  std::vector<Prediction> predicted(active_.size());
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> known;  // pixel, step
  std::vector<std::size_t> unknown;
  const double last_s = SecondsBetween(before_previous_stamp_ns_, previous_stamp_ns_);
  const double ratio =
      last_s > 0.0 ? std::min(2.0, SecondsBetween(previous_stamp_ns_, stamp_ns) / last_s) : 1.0;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const auto& observations = active_[i].track.observations;
    const std::size_t n = observations.size();
    const LiveObservation& last = observations[n - 1];
    predicted[i].pixel = last.pixel;
    predicted[i].affine_from_first = last.affine_from_first;
    if (n < 2) {
      unknown.push_back(i);
      continue;
    }
    Eigen::Vector2d step = last.pixel - observations[n - 2].pixel;
    if (n > 2) {
      const double before = (observations[n - 2].pixel - observations[n - 3].pixel).norm();
      // Only steps well above the noise tell how they grow.
      if (before > 2.0) step *= std::clamp(step.norm() / before, 0.6, 1.6);
      predicted[i].affine_from_first = last.affine_from_first *
                                       observations[n - 2].affine_from_first.inverse() *
                                       last.affine_from_first;
    }
    predicted[i].pixel += ratio * step;
    known.emplace_back(last.pixel, ratio * step);
  }
  for (std::size_t i : unknown) BorrowMotion(known, &predicted[i]);
  return predicted;
}

/// Adds the median motion of the nearest features whose motion is known.
void LiveTracker::BorrowMotion(
    const std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>>& known,
    Prediction* predicted) const {
  constexpr std::size_t kNeighbours = 5;
  if (known.size() < kNeighbours) return;
  std::vector<std::pair<double, std::size_t>> nearest(known.size());
  for (std::size_t k = 0; k < known.size(); ++k) {
    nearest[k] = {(known[k].first - predicted->pixel).squaredNorm(), k};
  }
  std::partial_sort(nearest.begin(), nearest.begin() + kNeighbours, nearest.end());
  double x[kNeighbours], y[kNeighbours];
  for (std::size_t k = 0; k < kNeighbours; ++k) {
    x[k] = known[nearest[k].second].second.x();
    y[k] = known[nearest[k].second].second.y();
  }
  std::sort(x, x + kNeighbours);
  std::sort(y, y + kNeighbours);
  predicted->pixel += Eigen::Vector2d(x[kNeighbours / 2], y[kNeighbours / 2]);
}

void LiveTracker::Follow(const GrayImage& image, const FlowPyramid& pyramid, FrameTracking* frame) {
  std::vector<Prediction> predicted = Predict(image.stamp_ns);
  std::vector<Eigen::Vector2d> before, expected;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    before.push_back(active_[i].track.observations.back().pixel);
    expected.push_back(predicted[i].pixel);
  }
  const auto flow = FlowThereAndBack(previous_pyramid_, pyramid, before, expected, options_.flow);
  std::vector<char> is_extended(active_.size(), 0);
  const auto for_each = [this](const auto& body) {
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, active_.size(), 32),
                      [&](const tbb::blocked_range<std::size_t>& range) {
                        for (std::size_t i = range.begin(); i < range.end(); ++i) body(i);
                      });
  };
  for_each([&](std::size_t i) {
    if (!flow[i]) return;
    predicted[i].pixel = *flow[i];
    is_extended[i] = Extend(image, predicted[i], &active_[i]) ? 1 : 0;
  });
  EstimateSceneFlow(is_extended);
  if (scene_flow_) {
    for_each([&](std::size_t i) {
      if (is_extended[i] != 0) return;
      const auto step = scene_flow_->Predict(before[i]);
      is_extended[i] = step && Rescue(image, pyramid, *step, &active_[i]) ? 1 : 0;
    });
  }
  frame->num_rejected += EndOthers(is_extended, false);
}

/// Registers one feature against its patch; false when the track ends here.
bool LiveTracker::Extend(const GrayImage& image, const Prediction& predicted,
                         ActiveTrack* active_track) const {
  const RegistrationOptions& registration = options_.registration;
  PatchWarp initial;
  initial.center_px = predicted.pixel;
  initial.affine = predicted.affine_from_first * active_track->patch_affine_from_first.inverse();
  const PatchRegistrationLimits limits{registration.max_iterations,
                                       kLiveConvergence * registration.convergence_px,
                                       registration.max_correction_px};
  const auto match = active_track->patch.Register(image.pixels, initial, limits);
  if (!match || match->ncc < registration.min_live_ncc || !IsSet(domain_, match->warp.center_px)) {
    return false;
  }
  LiveObservation observation;
  observation.stamp_ns = image.stamp_ns;
  observation.pixel = match->warp.center_px;
  observation.affine_from_first = match->warp.affine * active_track->patch_affine_from_first;
  if (ScaleChange(match->warp.affine) > registration.max_live_scale) {
    // Drift that this brings is undone by the final registration against one reference.
    auto patch = PatchTemplate::Create(image.pixels, observation.pixel, registration.live_radius_px,
                                       WarpFreedom::kAffine);
    if (!patch) return false;
    active_track->patch = std::move(*patch);
    active_track->patch_affine_from_first = observation.affine_from_first;
  }
  active_track->track.observations.push_back(observation);
  return true;
}

/// From the tracks that reached the newest image.
void LiveTracker::EstimateSceneFlow(const std::vector<char>& is_extended) {
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> pixels;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    if (is_extended[i] == 0) continue;
    const auto& observations = active_[i].track.observations;
    pixels.emplace_back(observations[observations.size() - 2].pixel, observations.back().pixel);
  }
  const VerificationOptions& verification = options_.verification;
  scene_flow_ = SceneFlow::Estimate(
      *model_, pixels, verification.min_motion_px,
      {verification.ransac_iterations / 2, verification.max_epipolar_error_px, 1});
}

/// Finds by scene flow what the search did not: first the shift at half resolution, where it may be
/// large, against the previous image; then Extend.
bool LiveTracker::Rescue(const GrayImage& image, const FlowPyramid& pyramid, const PatchWarp& step,
                         ActiveTrack* active_track) const {
  constexpr std::size_t kHalfSize = 2;  // in OpenCV's order of a pyramid
  const LiveObservation& last = active_track->track.observations.back();
  Prediction predicted{step.center_px, step.affine * last.affine_from_first};
  if (pyramid.size() > kHalfSize && previous_pyramid_.size() > kHalfSize) {
    const auto patch =
        PatchTemplate::Create(previous_pyramid_[kHalfSize], 0.5 * last.pixel,
                              options_.registration.live_radius_px, WarpFreedom::kShift);
    if (!patch) return false;
    PatchWarp half = step;
    half.center_px *= 0.5;
    const auto match =
        patch->Register(pyramid[kHalfSize], half,
                        {options_.registration.max_iterations, 0.05, kMaxRescueShiftPx / 2.0});
    if (!match || match->ncc < options_.registration.min_live_ncc) return false;
    predicted.pixel = 2.0 * match->warp.center_px;
  }
  return Extend(image, predicted, active_track);
}

int LiveTracker::EndOthers(const std::vector<char>& is_kept, bool forget) {
  const auto min_observations = static_cast<std::size_t>(options_.verification.min_observations);
  std::vector<ActiveTrack> kept;
  kept.reserve(active_.size());
  for (std::size_t i = 0; i < active_.size(); ++i) {
    if (is_kept[i] != 0) {
      kept.push_back(std::move(active_[i]));
    } else if (!forget && active_[i].track.observations.size() >= min_observations) {
      finished_.push_back(std::move(active_[i].track));
    }
  }
  const auto num_ended = static_cast<int>(active_.size() - kept.size());
  active_ = std::move(kept);
  return num_ended;
}

/// Of two tracks that ran into each other the one with the shorter history ends.
void LiveTracker::RemoveDuplicates(FrameTracking* frame) {
  std::vector<std::size_t> order(active_.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [this](std::size_t a, std::size_t b) {
    return active_[a].track.observations.size() > active_[b].track.observations.size();
  });
  cv::Mat taken(domain_.size(), CV_8UC1, cv::Scalar(0));
  std::vector<char> is_kept(active_.size(), 1);
  for (std::size_t i : order) {
    const Eigen::Vector2d pixel = active_[i].track.observations.back().pixel;
    if (IsSet(taken, pixel)) {
      is_kept[i] = 0;
      active_[i].track.observations.pop_back();  // this sighting belongs to the other track
    } else {
      cv::circle(taken, ToPoint(pixel), kMergeDistancePx, cv::Scalar(255), cv::FILLED);
    }
  }
  frame->num_rejected += EndOthers(is_kept, false);
}

/// Ends and forgets what is fixed to the vehicle, and keeps new features off it.
void LiveTracker::RemoveFixed(FrameTracking* frame) {
  std::vector<FeatureMotion> motions;
  std::vector<std::size_t> judged;
  for (std::size_t i = 0; i < active_.size(); ++i) {
    const auto& observations = active_[i].track.observations;
    if (observations.size() < kStaticWindow) continue;
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
    cv::circle(fixed_, ToPoint(motions[k].pixel), kFixedMarginPx, cv::Scalar(255), cv::FILLED);
  }
  frame->num_rejected += EndOthers(is_kept, true);
}

/// Clears the mask where a new feature would be out of the image in the next one, were the motion
/// to go on.
void LiveTracker::MaskWhatLeaves(cv::Mat* mask) const {
  if (!scene_flow_) return;
  constexpr int kCellPx = 40;
  const int columns = (mask->cols + kCellPx - 1) / kCellPx;
  const int rows = (mask->rows + kCellPx - 1) / kCellPx;
  std::vector<char> leaves(static_cast<std::size_t>(columns * rows), 0);
  tbb::parallel_for(0, columns * rows, [&](int cell) {
    const Eigen::Vector2d center((cell % columns + 0.5) * kCellPx,
                                 (cell / columns + 0.5) * kCellPx);
    if (!IsSet(domain_, center)) return;
    const auto step = scene_flow_->Predict(center);
    leaves[cell] = step && IsSet(domain_, step->center_px) ? 0 : 1;
  });
  const cv::Rect whole(0, 0, mask->cols, mask->rows);
  for (int cell = 0; cell < columns * rows; ++cell) {
    if (leaves[cell] == 0) continue;
    const cv::Rect area(cell % columns * kCellPx, cell / columns * kCellPx, kCellPx, kCellPx);
    (*mask)(area & whole).setTo(0);
  }
}

void LiveTracker::Detect(const GrayImage& image, const cv::Mat& equalised, FrameTracking* frame) {
  cv::Mat mask = Mask();
  MaskWhatLeaves(&mask);
  std::vector<Eigen::Vector2d> live;
  live.reserve(active_.size());
  for (const ActiveTrack& track : active_) live.push_back(track.track.observations.back().pixel);
  for (const Eigen::Vector2d& pixel : DetectFeatures(equalised, mask, live, options_.detection)) {
    auto patch = PatchTemplate::Create(image.pixels, pixel, options_.registration.live_radius_px,
                                       WarpFreedom::kAffine);
    if (!patch) continue;
    LiveTrack track;
    track.id = next_id_++;
    track.observations.push_back({image.stamp_ns, pixel, Eigen::Matrix2d::Identity()});
    active_.push_back({std::move(track), std::move(*patch), Eigen::Matrix2d::Identity()});
    ++frame->num_new;
  }
}

void LiveTracker::Forget(Timestamp stamp_ns) {
  const auto forget = [stamp_ns](LiveTrack* track) {
    auto& observations = track->observations;
    const auto first_kept = std::find_if(
        observations.begin(), observations.end(),
        [stamp_ns](const LiveObservation& observation) { return observation.stamp_ns > stamp_ns; });
    observations.erase(observations.begin(), first_kept);
  };
  for (ActiveTrack& track : active_) forget(&track.track);
  for (LiveTrack& track : finished_) forget(&track);
  const auto min_observations = static_cast<std::size_t>(options_.verification.min_observations);
  finished_.erase(std::remove_if(finished_.begin(), finished_.end(),
                                 [min_observations](const LiveTrack& track) {
                                   return track.observations.size() < min_observations;
                                 }),
                  finished_.end());
}

std::vector<LiveTrack> LiveTracker::Tracks() const {
  std::vector<LiveTrack> tracks = finished_;
  for (const ActiveTrack& track : active_) tracks.push_back(track.track);
  return tracks;
}

cv::Mat LiveTracker::Mask() const {
  cv::Mat mask = domain_.clone();
  mask.setTo(0, fixed_);
  return mask;
}

}  // namespace scenecalib
