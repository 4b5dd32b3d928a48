#include "scenecalib/tracking/camera_tracker.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <optional>
#include <string>
#include <utility>

#include "scenecalib/tracking/feature_detector.h"
#include "scenecalib/tracking/patch_registration.h"
#include "scenecalib/tracking/reference_registration.h"
#include "scenecalib/tracking/scene_flow.h"
#include "scenecalib/tracking/track_verification.h"

// From images to live tracks, one image at a time (AddImage):
//   predict where each feature goes -> pyramidal Lucas-Kanade there and back -> registration of the
//   patch against an earlier view of the same track, which stops drift and chains the affine warp
//   -> a second try, where the others' motion predicts it, for what was lost (scene_flow.h)
//   -> drop what is fixed to the vehicle -> detect new features where there is room.
// From live tracks to verified ones (Segment): reference_registration.h, track_verification.h.

namespace scenecalib {
namespace {

/// Images after which a feature's motion is compared with its neighbours' (FindFixedToVehicle).
constexpr std::size_t kStaticWindow = 8;
/// New features keep off this far from something fixed to the vehicle.
constexpr int kFixedMarginPx = 7;
/// Two live tracks nearer than this follow the same thing: the younger ends.
constexpr double kMergeDistancePx = 4.0;
/// How far from its prediction by scene flow a lost feature is looked for.
constexpr double kMaxRescueShiftPx = 10.0;
/// Mean grey value and its deviation below which an image counts as black.
constexpr double kBlackMean = 3.0;
constexpr double kBlackDeviation = 2.0;

/// A track that is still being followed, with the patch it is compared with.
struct ActiveTrack {
  LiveTrack track;
  PatchTemplate patch;
  Eigen::Matrix2d patch_affine_from_first = Eigen::Matrix2d::Identity();
};

/// Where a feature is expected, and by how much its surroundings are stretched there.
struct Prediction {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Matrix2d affine_from_first = Eigen::Matrix2d::Identity();
};

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

struct CameraTracker::Impl {
  std::string name;
  CameraModelPtr model;
  TrackingOptions options;

  cv::Mat domain;  ///< 255 where a whole patch sees the scene through the model
  cv::Mat fixed;   ///< 255 where something fixed to the vehicle was found
  std::map<Timestamp, cv::Mat> images;
  std::vector<ActiveTrack> active;
  std::vector<LiveTrack> finished;
  std::int64_t next_id = 0;
  std::vector<cv::Mat> previous_pyramid;
  std::optional<SceneFlow> scene_flow;  ///< between the last two images
  bool previous_equalised = false;
  Timestamp previous_stamp_ns = 0;
  Timestamp before_previous_stamp_ns = 0;
  int num_images_in = 0;
  int num_images_black = 0;
  int num_images_dropped = 0;
  double brightness_sum = 0.0;

  Status Check(const GrayImage& image) const;
  std::vector<cv::Mat> BuildPyramid(const cv::Mat& image, bool equalise) const;
  std::vector<Prediction> Predict(Timestamp stamp_ns) const;
  std::vector<std::optional<Eigen::Vector2d>> Flow(const std::vector<cv::Mat>& pyramid,
                                                   const std::vector<Prediction>& predicted) const;
  void Follow(const GrayImage& image, const std::vector<cv::Mat>& pyramid, FrameTracking* frame);
  bool Extend(const GrayImage& image, const Prediction& predicted,
              const Eigen::Vector2d& flow_pixel, ActiveTrack* active_track) const;
  bool Rescue(const GrayImage& image, const std::vector<cv::Mat>& pyramid, const PatchWarp& step,
              ActiveTrack* active_track) const;
  void EstimateSceneFlow(const std::vector<char>& is_extended);
  void MaskWhatLeaves(cv::Mat* mask) const;
  void RemoveDuplicates(FrameTracking* frame);
  void RemoveFixed(FrameTracking* frame);
  void Detect(const GrayImage& image, const cv::Mat& equalised, FrameTracking* frame);
  void ForgetOldest();
  void Finish(ActiveTrack* active_track);
};

Status CameraTracker::Impl::Check(const GrayImage& image) const {
  if (!model) {
    return Status::InvalidArgument(name + ": no camera model; its intrinsics have not arrived");
  }
  if (image.pixels.type() != CV_8UC1) {
    return Status::InvalidArgument(name + ": image is not 8-bit grey");
  }
  if (image.pixels.cols != model->width_px() || image.pixels.rows != model->height_px()) {
    return Status::InvalidArgument(name + ": image is " + std::to_string(image.pixels.cols) + "x" +
                                   std::to_string(image.pixels.rows) + " but the camera model is " +
                                   std::to_string(model->width_px()) + "x" +
                                   std::to_string(model->height_px()));
  }
  if (num_images_in > 0 && image.stamp_ns <= previous_stamp_ns) {
    return Status::InvalidArgument(name + ": image stamp runs backwards or repeats (" +
                                   std::to_string(image.stamp_ns) + " ns after " +
                                   std::to_string(previous_stamp_ns) + " ns)");
  }
  return Status::Ok();
}

/// Pyramid for Lucas-Kanade; dark images are equalised first, because OpenCV's flow works on whole
/// grey values and its thresholds know nothing of exposure.
std::vector<cv::Mat> CameraTracker::Impl::BuildPyramid(const cv::Mat& image, bool equalise) const {
  cv::Mat equalised = image;
  if (equalise) cv::createCLAHE(4.0, {8, 8})->apply(image, equalised);
  std::vector<cv::Mat> pyramid;
  const cv::Size window(options.flow.window_px, options.flow.window_px);
  cv::buildOpticalFlowPyramid(equalised, pyramid, window, options.flow.pyramid_levels, true);
  return pyramid;
}

/// Motion under perspective grows geometrically as things come nearer, so the last step is repeated
/// with its own growth; a feature without history borrows its neighbours' motion.
std::vector<Prediction> CameraTracker::Impl::Predict(Timestamp stamp_ns) const {
  std::vector<Prediction> predicted(active.size());
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> known;  // pixel, step
  std::vector<std::size_t> unknown;
  const double last_s = SecondsBetween(before_previous_stamp_ns, previous_stamp_ns);
  const double ratio =
      last_s > 0.0 ? std::min(2.0, SecondsBetween(previous_stamp_ns, stamp_ns) / last_s) : 1.0;
  for (std::size_t i = 0; i < active.size(); ++i) {
    const auto& observations = active[i].track.observations;
    const std::size_t n = observations.size();
    predicted[i].pixel = observations[n - 1].pixel;
    predicted[i].affine_from_first = observations[n - 1].affine_from_first;
    if (n < 2) {
      unknown.push_back(i);
      continue;
    }
    Eigen::Vector2d step = observations[n - 1].pixel - observations[n - 2].pixel;
    const Eigen::Matrix2d growth =
        observations[n - 1].affine_from_first * observations[n - 2].affine_from_first.inverse();
    if (n > 2) {
      const double before = (observations[n - 2].pixel - observations[n - 3].pixel).norm();
      // Only steps well above the noise tell how they grow.
      if (before > 2.0) step *= std::clamp(step.norm() / before, 0.6, 1.6);
      predicted[i].affine_from_first = growth * observations[n - 1].affine_from_first;
    }
    predicted[i].pixel += ratio * step;
    known.emplace_back(observations[n - 1].pixel, ratio * step);
  }
  for (std::size_t i : unknown) {
    constexpr std::size_t kNeighbours = 5;
    if (known.size() < kNeighbours) continue;
    std::vector<std::pair<double, std::size_t>> nearest;
    nearest.reserve(known.size());
    for (std::size_t k = 0; k < known.size(); ++k) {
      nearest.emplace_back((known[k].first - predicted[i].pixel).squaredNorm(), k);
    }
    std::partial_sort(nearest.begin(), nearest.begin() + kNeighbours, nearest.end());
    double x[kNeighbours], y[kNeighbours];
    for (std::size_t k = 0; k < kNeighbours; ++k) {
      x[k] = known[nearest[k].second].second.x();
      y[k] = known[nearest[k].second].second.y();
    }
    std::sort(x, x + kNeighbours);
    std::sort(y, y + kNeighbours);
    predicted[i].pixel += Eigen::Vector2d(x[kNeighbours / 2], y[kNeighbours / 2]);
  }
  return predicted;
}

/// Lucas-Kanade from the previous image and back again; none where the two disagree.
std::vector<std::optional<Eigen::Vector2d>> CameraTracker::Impl::Flow(
    const std::vector<cv::Mat>& pyramid, const std::vector<Prediction>& predicted) const {
  std::vector<std::optional<Eigen::Vector2d>> flow(active.size());
  if (active.empty()) return flow;
  std::vector<cv::Point2f> before, after, back;
  for (std::size_t i = 0; i < active.size(); ++i) {
    before.push_back(ToPoint(active[i].track.observations.back().pixel));
    after.push_back(ToPoint(predicted[i].pixel));
  }
  back = before;
  std::vector<uchar> found, found_back;
  std::vector<float> error;
  const cv::Size window(options.flow.window_px, options.flow.window_px);
  const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 20, 0.03);
  const int levels = options.flow.pyramid_levels;
  cv::calcOpticalFlowPyrLK(previous_pyramid, pyramid, before, after, found, error, window, levels,
                           criteria, cv::OPTFLOW_USE_INITIAL_FLOW);
  cv::calcOpticalFlowPyrLK(pyramid, previous_pyramid, after, back, found_back, error, window,
                           levels, criteria, cv::OPTFLOW_USE_INITIAL_FLOW);
  for (std::size_t i = 0; i < active.size(); ++i) {
    const cv::Point2f gap = back[i] - before[i];
    if (found[i] != 0 && found_back[i] != 0 &&
        std::hypot(gap.x, gap.y) <= options.flow.max_forward_backward_px) {
      flow[i] = Eigen::Vector2d(after[i].x, after[i].y);
    }
  }
  return flow;
}

/// Registers one feature against its patch; false when the track ends here.
bool CameraTracker::Impl::Extend(const GrayImage& image, const Prediction& predicted,
                                 const Eigen::Vector2d& flow_pixel,
                                 ActiveTrack* active_track) const {
  const RegistrationOptions& registration = options.registration;
  PatchWarp initial;
  initial.center_px = flow_pixel;
  initial.affine = predicted.affine_from_first * active_track->patch_affine_from_first.inverse();
  const PatchRegistrationLimits limits{registration.max_iterations,
                                       4.0 * registration.convergence_px,
                                       registration.max_correction_px};
  const auto match = active_track->patch.Register(image.pixels, initial, limits);
  if (!match || match->ncc < registration.min_live_ncc || !IsSet(domain, match->warp.center_px)) {
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

void CameraTracker::Impl::Finish(ActiveTrack* active_track) {
  if (static_cast<int>(active_track->track.observations.size()) >=
      options.verification.min_observations) {
    finished.push_back(std::move(active_track->track));
  }
}

/// Finds by scene flow what the search did not: first the shift at half resolution, where it may be
/// large, against the previous image; then Extend.
bool CameraTracker::Impl::Rescue(const GrayImage& image, const std::vector<cv::Mat>& pyramid,
                                 const PatchWarp& step, ActiveTrack* active_track) const {
  constexpr std::size_t kHalfResolution = 2;  // the pyramid holds image, derivatives, image, ...
  const LiveObservation& last = active_track->track.observations.back();
  Prediction predicted;
  predicted.pixel = step.center_px;
  predicted.affine_from_first = step.affine * last.affine_from_first;
  if (pyramid.size() > kHalfResolution && previous_pyramid.size() > kHalfResolution) {
    const auto patch =
        PatchTemplate::Create(previous_pyramid[kHalfResolution], 0.5 * last.pixel,
                              options.registration.live_radius_px, WarpFreedom::kShift);
    if (!patch) return false;
    PatchWarp half = step;
    half.center_px *= 0.5;
    const auto match =
        patch->Register(pyramid[kHalfResolution], half,
                        {options.registration.max_iterations, 0.05, kMaxRescueShiftPx / 2.0});
    if (!match || match->ncc < options.registration.min_live_ncc) return false;
    predicted.pixel = 2.0 * match->warp.center_px;
  }
  return Extend(image, predicted, predicted.pixel, active_track);
}

void CameraTracker::Impl::Follow(const GrayImage& image, const std::vector<cv::Mat>& pyramid,
                                 FrameTracking* frame) {
  const std::vector<Prediction> predicted = Predict(image.stamp_ns);
  const auto flow = Flow(pyramid, predicted);
  std::vector<char> is_extended(active.size(), 0);
  const auto for_each = [this](const auto& body) {
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, active.size(), 32),
                      [&](const tbb::blocked_range<std::size_t>& range) {
                        for (std::size_t i = range.begin(); i < range.end(); ++i) body(i);
                      });
  };
  for_each([&](std::size_t i) {
    is_extended[i] = flow[i] && Extend(image, predicted[i], *flow[i], &active[i]) ? 1 : 0;
  });
  EstimateSceneFlow(is_extended);
  if (scene_flow) {
    for_each([&](std::size_t i) {
      if (is_extended[i] != 0) return;
      const auto step = scene_flow->Predict(active[i].track.observations.back().pixel);
      is_extended[i] = step && Rescue(image, pyramid, *step, &active[i]) ? 1 : 0;
    });
  }
  std::vector<ActiveTrack> kept;
  kept.reserve(active.size());
  for (std::size_t i = 0; i < active.size(); ++i) {
    if (is_extended[i] != 0) {
      kept.push_back(std::move(active[i]));
    } else {
      Finish(&active[i]);
      ++frame->num_rejected;
    }
  }
  active = std::move(kept);
}

/// From the tracks that reached the newest image.
void CameraTracker::Impl::EstimateSceneFlow(const std::vector<char>& is_extended) {
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> pixels;
  for (std::size_t i = 0; i < active.size(); ++i) {
    if (is_extended[i] == 0) continue;
    const auto& observations = active[i].track.observations;
    pixels.emplace_back(observations[observations.size() - 2].pixel, observations.back().pixel);
  }
  const VerificationOptions& verification = options.verification;
  scene_flow = SceneFlow::Estimate(
      *model, pixels, verification.min_motion_px,
      {verification.ransac_iterations / 2, verification.max_epipolar_error_px, 1});
}

/// Of two tracks that ran into each other the one with the shorter history ends.
void CameraTracker::Impl::RemoveDuplicates(FrameTracking* frame) {
  std::vector<std::size_t> order(active.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(), [this](std::size_t a, std::size_t b) {
    return active[a].track.observations.size() > active[b].track.observations.size();
  });
  cv::Mat taken(model->height_px(), model->width_px(), CV_8UC1, cv::Scalar(0));
  std::vector<char> is_duplicate(active.size(), 0);
  for (std::size_t i : order) {
    const Eigen::Vector2d& pixel = active[i].track.observations.back().pixel;
    if (IsSet(taken, pixel)) {
      is_duplicate[i] = 1;
    } else {
      cv::circle(taken, ToPoint(pixel), static_cast<int>(kMergeDistancePx), cv::Scalar(255),
                 cv::FILLED);
    }
  }
  std::vector<ActiveTrack> kept;
  kept.reserve(active.size());
  for (std::size_t i = 0; i < active.size(); ++i) {
    if (is_duplicate[i] == 0) {
      kept.push_back(std::move(active[i]));
      continue;
    }
    // Its last sighting already belongs to the other track.
    active[i].track.observations.pop_back();
    Finish(&active[i]);
    ++frame->num_rejected;
  }
  active = std::move(kept);
}

/// Ends and forgets what is fixed to the vehicle, and keeps new features off it.
void CameraTracker::Impl::RemoveFixed(FrameTracking* frame) {
  std::vector<FeatureMotion> motions;
  std::vector<std::size_t> judged;
  for (std::size_t i = 0; i < active.size(); ++i) {
    const auto& observations = active[i].track.observations;
    if (observations.size() < kStaticWindow) continue;
    FeatureMotion motion;
    motion.pixel = observations.back().pixel;
    motion.duration_s = SecondsBetween(observations[observations.size() - kStaticWindow].stamp_ns,
                                       observations.back().stamp_ns);
    for (std::size_t k = observations.size() - kStaticWindow; k < observations.size(); ++k) {
      motion.extent_px = std::max(motion.extent_px, (observations[k].pixel - motion.pixel).norm());
    }
    motions.push_back(motion);
    judged.push_back(i);
  }
  const std::vector<bool> is_fixed = FindFixedToVehicle(motions, options.verification);
  std::vector<char> remove(active.size(), 0);
  for (std::size_t k = 0; k < judged.size(); ++k) {
    if (!is_fixed[k]) continue;
    remove[judged[k]] = 1;
    cv::circle(fixed, ToPoint(motions[k].pixel), kFixedMarginPx, cv::Scalar(255), cv::FILLED);
  }
  std::vector<ActiveTrack> kept;
  kept.reserve(active.size());
  for (std::size_t i = 0; i < active.size(); ++i) {
    if (remove[i] == 0) {
      kept.push_back(std::move(active[i]));
    } else {
      ++frame->num_rejected;
    }
  }
  active = std::move(kept);
}

/// Clears the mask where a new feature would be out of the image in the next one, were the motion
/// to go on.
void CameraTracker::Impl::MaskWhatLeaves(cv::Mat* mask) const {
  if (!scene_flow) return;
  constexpr int kCellPx = 32;
  const int columns = (mask->cols + kCellPx - 1) / kCellPx;
  const int rows = (mask->rows + kCellPx - 1) / kCellPx;
  std::vector<char> leaves(static_cast<std::size_t>(columns * rows), 0);
  tbb::parallel_for(0, columns * rows, [&](int cell) {
    const Eigen::Vector2d center((cell % columns + 0.5) * kCellPx,
                                 (cell / columns + 0.5) * kCellPx);
    if (!IsSet(domain, center)) return;
    const auto step = scene_flow->Predict(center);
    leaves[cell] = step && IsSet(domain, step->center_px) ? 0 : 1;
  });
  const cv::Rect whole(0, 0, mask->cols, mask->rows);
  for (int cell = 0; cell < columns * rows; ++cell) {
    if (leaves[cell] == 0) continue;
    const cv::Rect area(cell % columns * kCellPx, cell / columns * kCellPx, kCellPx, kCellPx);
    (*mask)(area & whole).setTo(0);
  }
}

void CameraTracker::Impl::Detect(const GrayImage& image, const cv::Mat& equalised,
                                 FrameTracking* frame) {
  cv::Mat mask = domain.clone();
  mask.setTo(0, fixed);
  MaskWhatLeaves(&mask);
  std::vector<Eigen::Vector2d> live;
  live.reserve(active.size());
  for (const ActiveTrack& track : active) live.push_back(track.track.observations.back().pixel);
  for (const Eigen::Vector2d& pixel : DetectFeatures(equalised, mask, live, options.detection)) {
    auto patch = PatchTemplate::Create(image.pixels, pixel, options.registration.live_radius_px,
                                       WarpFreedom::kAffine);
    if (!patch) continue;
    LiveTrack track;
    track.id = next_id++;
    track.observations.push_back({image.stamp_ns, pixel, Eigen::Matrix2d::Identity()});
    active.push_back({std::move(track), std::move(*patch), Eigen::Matrix2d::Identity()});
    ++frame->num_new;
  }
}

/// Keeps memory within buffer.max_images: the oldest image goes, with every sighting in it.
void CameraTracker::Impl::ForgetOldest() {
  while (static_cast<int>(images.size()) > options.buffer.max_images) {
    const Timestamp stamp_ns = images.begin()->first;
    images.erase(images.begin());
    ++num_images_dropped;
    const auto forget = [stamp_ns](LiveTrack* track) {
      auto& observations = track->observations;
      if (!observations.empty() && observations.front().stamp_ns <= stamp_ns) {
        observations.erase(observations.begin());
      }
    };
    for (ActiveTrack& track : active) forget(&track.track);
    for (LiveTrack& track : finished) forget(&track);
    const auto min_observations = static_cast<std::size_t>(options.verification.min_observations);
    finished.erase(std::remove_if(finished.begin(), finished.end(),
                                  [min_observations](const LiveTrack& track) {
                                    return track.observations.size() < min_observations;
                                  }),
                   finished.end());
  }
}

CameraTracker::CameraTracker(std::string name, CameraModelPtr model, const TrackingOptions& options)
    : impl_(std::make_unique<Impl>()) {
  impl_->name = std::move(name);
  impl_->model = std::move(model);
  impl_->options = options;
  Reset();
}

CameraTracker::~CameraTracker() = default;
CameraTracker::CameraTracker(CameraTracker&&) noexcept = default;
CameraTracker& CameraTracker::operator=(CameraTracker&&) noexcept = default;

void CameraTracker::Reset() {
  auto fresh = std::make_unique<Impl>();
  fresh->name = impl_->name;
  fresh->model = impl_->model;
  fresh->options = impl_->options;
  fresh->domain = impl_->domain;
  if (fresh->model) {
    if (fresh->domain.empty()) {
      fresh->domain = MakeDomainMask(*fresh->model, fresh->options.registration.live_radius_px + 2);
    }
    fresh->fixed = cv::Mat(fresh->domain.size(), CV_8UC1, cv::Scalar(0));
  }
  impl_ = std::move(fresh);
}

Result<FrameTracking> CameraTracker::AddImage(const GrayImage& image) {
  SCENECALIB_RETURN_IF_ERROR(impl_->Check(image));
  FrameTracking frame;
  frame.stamp_ns = image.stamp_ns;
  const GrayImage kept{image.stamp_ns, image.pixels.clone()};  // the caller may reuse its buffer
  cv::Scalar mean, deviation;
  cv::meanStdDev(kept.pixels, mean, deviation);
  frame.mean_brightness = mean[0];

  Impl& impl = *impl_;
  const bool equalise = mean[0] < impl.options.flow.dark_mean;
  if (equalise != impl.previous_equalised && !impl.images.empty()) {
    // Both images of a pair must have been treated alike.
    impl.previous_pyramid = impl.BuildPyramid(impl.images.rbegin()->second, equalise);
  }
  std::vector<cv::Mat> pyramid = impl.BuildPyramid(kept.pixels, equalise);
  if (!impl.images.empty()) impl.Follow(kept, pyramid, &frame);
  impl.RemoveDuplicates(&frame);
  impl.RemoveFixed(&frame);
  frame.num_tracked = static_cast<int>(impl.active.size());
  const bool is_black = mean[0] < kBlackMean && deviation[0] < kBlackDeviation;
  if (!is_black) impl.Detect(kept, pyramid.front(), &frame);

  impl.images.emplace(kept.stamp_ns, kept.pixels);
  impl.previous_pyramid = std::move(pyramid);
  impl.previous_equalised = equalise;
  impl.before_previous_stamp_ns = impl.num_images_in > 0 ? impl.previous_stamp_ns : kept.stamp_ns;
  impl.previous_stamp_ns = kept.stamp_ns;
  ++impl.num_images_in;
  impl.num_images_black += is_black ? 1 : 0;
  impl.brightness_sum += mean[0];
  impl.ForgetOldest();
  return frame;
}

CameraSegment CameraTracker::Segment() const {
  const Impl& impl = *impl_;
  CameraSegment segment;
  segment.images = impl.images;
  segment.num_images_in = impl.num_images_in;
  segment.num_images_dropped_at_bound = impl.num_images_dropped;
  if (impl.num_images_in > 0) segment.mean_brightness = impl.brightness_sum / impl.num_images_in;
  if (impl.num_images_black > 0) {
    segment.warnings.push_back(impl.name + ": " + std::to_string(impl.num_images_black) + " of " +
                               std::to_string(impl.num_images_in) + " images are black");
  }
  if (impl.images.empty()) return segment;

  cv::Mat mask = impl.domain.clone();
  mask.setTo(0, impl.fixed);
  std::vector<LiveTrack> live = impl.finished;
  for (const ActiveTrack& track : impl.active) live.push_back(track.track);
  const VerificationOptions& verification = impl.options.verification;
  segment.tracks = RegisterAgainstReference(live, impl.images, mask, verification.min_observations,
                                            impl.options.registration);
  VerifyTracks(*impl.model, verification, &segment.tracks);
  if (segment.tracks.empty()) {
    segment.warnings.push_back(impl.name + ": no feature could be tracked in " +
                               std::to_string(impl.num_images_in) + " images");
  }
  return segment;
}

cv::Mat CameraTracker::DebugImage() const {
  cv::Mat drawn;
  if (impl_->images.empty()) return drawn;
  cv::cvtColor(impl_->images.rbegin()->second, drawn, cv::COLOR_GRAY2BGR);
  constexpr std::size_t kTail = 10;
  for (const ActiveTrack& active : impl_->active) {
    const auto& observations = active.track.observations;
    const std::size_t n = observations.size();
    // Young tracks red, old ones green.
    const double age = std::min(1.0, static_cast<double>(n) / 20.0);
    const cv::Scalar colour(0, 255 * age, 255 * (1.0 - age));
    for (std::size_t k = n > kTail ? n - kTail : 1; k < n; ++k) {
      cv::line(drawn, ToPoint(observations[k - 1].pixel), ToPoint(observations[k].pixel), colour, 1,
               cv::LINE_AA);
    }
    cv::circle(drawn, ToPoint(observations.back().pixel), 2, colour, cv::FILLED, cv::LINE_AA);
  }
  return drawn;
}

}  // namespace scenecalib
