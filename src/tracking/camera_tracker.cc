#include "scenecalib/tracking/camera_tracker.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scenecalib/tracking/image_store.h"
#include "scenecalib/tracking/live_tracker.h"
#include "scenecalib/tracking/noisy_images.h"
#include "scenecalib/tracking/reference_registration.h"
#include "scenecalib/tracking/track_extension.h"
#include "scenecalib/tracking/track_selection.h"
#include "scenecalib/tracking/track_verification.h"

namespace scenecalib {

namespace {

/// Median over a dozen of the images.
ImageQuality TypicalQuality(const std::map<Timestamp, cv::Mat>& images, const cv::Mat& mask) {
  constexpr std::size_t kNumImages = 12;
  const std::size_t stride = std::max<std::size_t>(1, images.size() / kNumImages);
  std::vector<double> noise;
  std::vector<double> contrast;
  std::size_t i = 0;
  for (const auto& [stamp_ns, image] : images) {
    if (i++ % stride != 0) continue;
    const ImageQuality quality = MeasureImageQuality(image, mask);
    noise.push_back(quality.noise_levels);
    contrast.push_back(quality.contrast);
  }
  ImageQuality typical;
  if (noise.empty()) return typical;
  const auto middle = static_cast<std::ptrdiff_t>(noise.size() / 2);
  std::nth_element(noise.begin(), noise.begin() + middle, noise.end());
  std::nth_element(contrast.begin(), contrast.begin() + middle, contrast.end());
  typical.noise_levels = noise[static_cast<std::size_t>(middle)];
  typical.contrast = contrast[static_cast<std::size_t>(middle)];
  return typical;
}

template <typename TrackType>
std::size_t NumObservations(const std::vector<TrackType>& tracks) {
  std::size_t num_observations = 0;
  for (const TrackType& track : tracks) num_observations += track.observations.size();
  return num_observations;
}

/// RegistrationOptions::few_tracks_sigma_px.
TrackingOptions ForFewTracks(TrackingOptions options) {
  RegistrationOptions& registration = options.registration;
  registration.max_sigma_px = std::max(registration.max_sigma_px, registration.few_tracks_sigma_px);
  registration.max_misfit_px =
      std::max(registration.max_misfit_px, registration.few_tracks_sigma_px);
  registration.max_end_sigma_px =
      std::max(registration.max_end_sigma_px, registration.few_tracks_sigma_px);
  return options;
}

/// Verified tracks from what was followed.
std::vector<Track> RegisterAndVerify(const std::vector<LiveTrack>& followed,
                                     const CameraModel& model,
                                     const std::map<Timestamp, cv::Mat>& images,
                                     const cv::Mat& seen, const ImageQuality& quality,
                                     const TrackingOptions& options) {
  std::vector<RegisteredTrack> registered = RegisterAgainstReference(
      followed, images, seen, quality, options.verification.min_observations, options.registration);
  ExtendTracks(model, images, seen, quality, options, &registered);
  std::vector<Track> tracks;
  tracks.reserve(registered.size());
  for (RegisteredTrack& track : registered) tracks.push_back(std::move(track.track));
  VerifyTracks(model, options.verification, &tracks);
  return tracks;
}

/// The tracks that are worth registering in a recording so long: RegistrationOptions::max_tracks.
std::vector<LiveTrack> Selected(std::vector<LiveTrack> tracks, double duration_s,
                                const TrackingOptions& options, const CameraModel& model) {
  if (options.registration.max_tracks == 0) return tracks;
  std::vector<TrackSummary> summaries;
  summaries.reserve(tracks.size());
  for (const LiveTrack& track : tracks) {
    const LiveObservation& middle = track.observations[track.observations.size() / 2];
    summaries.push_back({middle.stamp_ns, middle.pixel, track.observations.size()});
  }
  std::vector<LiveTrack> selected;
  for (const std::size_t i :
       SelectSpread(summaries, TrackBudget(options.registration.max_tracks, model, duration_s),
                    static_cast<std::size_t>(options.verification.min_observations),
                    model.width_px(), model.height_px())) {
    selected.push_back(std::move(tracks[i]));
  }
  return selected;
}

}  // namespace

struct CameraTracker::Impl {
  Impl(std::string name_in, CameraModelPtr model_in, const TrackingOptions& options_in,
       const cv::Mat& mask_in)
      : name(std::move(name_in)),
        model(std::move(model_in)),
        options(options_in),
        mask(mask_in),
        grey(MaxBytes(options)),
        colour(MaxBytes(options)) {}

  static std::size_t MaxBytes(const TrackingOptions& options) {
    return static_cast<std::size_t>(options.buffer.max_memory_mib) << 20U;
  }

  std::string name;
  CameraModelPtr model;
  TrackingOptions options;
  cv::Mat mask;  ///< of the user, or empty

  std::optional<LiveTracker> live;  ///< none until the first image
  ImageStore grey;
  ImageStore colour;
  Status store_status;  ///< why images could not be kept, if so
  Timestamp last_stamp_ns = 0;
  int num_images_in = 0;
  int num_images_black = 0;
  int num_images_dropped = 0;
  int num_images_still = 0;
  Timestamp moved_stamp_ns = 0;  ///< of the newest image that is kept for good
  double brightness_sum = 0.0;

  Status Check(const GrayImage& image) const;
  void Keep(const GrayImage& kept, const cv::Mat& colour_pixels);
  void ForgetOldest();
  bool LooksAlike(Timestamp earlier_ns) const;
  void ForgetStill();
  void Register(const std::vector<LiveTrack>& followed, double followed_share, const cv::Mat& seen,
                const ImageQuality& quality, CameraSegment* segment) const;
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
  if (!mask.empty() && mask.size() != image.pixels.size()) {
    return Status::InvalidArgument(name + ": mask is " + std::to_string(mask.cols) + "x" +
                                   std::to_string(mask.rows) + ", not as the images");
  }
  if (num_images_in > 0 && image.stamp_ns <= last_stamp_ns) {
    return Status::InvalidArgument(name + ": image stamp runs backwards or repeats (" +
                                   std::to_string(image.stamp_ns) + " ns after " +
                                   std::to_string(last_stamp_ns) + " ns)");
  }
  return Status::Ok();
}

/// Keeps an image, and forgets the oldest ones beyond the bound or where there is no room for more.
void CameraTracker::Impl::Keep(const GrayImage& kept, const cv::Mat& colour_pixels) {
  Status status = grey.Add(kept.stamp_ns, kept.pixels);
  if (status.ok() && colour_pixels.type() == CV_8UC3 &&
      colour_pixels.size() == kept.pixels.size()) {
    status = colour.Add(kept.stamp_ns, colour_pixels.clone());
  }
  while (static_cast<int>(grey.images().size()) > options.buffer.max_images) ForgetOldest();
  if (status.ok()) return;
  store_status = status;
  while (grey.images().size() > 1 && grey.bytes_in_memory() > MaxBytes(options)) ForgetOldest();
  while (!colour.images().empty() && colour.bytes_in_memory() > MaxBytes(options)) {
    colour.Remove(colour.images().begin()->first);
  }
}

void CameraTracker::Impl::ForgetOldest() {
  const Timestamp oldest_ns = grey.images().begin()->first;
  live->Forget(oldest_ns);
  colour.Remove(oldest_ns);
  grey.Remove(oldest_ns);
  ++num_images_dropped;
}

/// Whether the newest image shows what an earlier one did. Features alone do not tell: at speed the
/// own vehicle may hold all that can be followed.
bool CameraTracker::Impl::LooksAlike(Timestamp earlier_ns) const {
  constexpr double kMaxChangedShare = 0.3;  // others may pass
  const cv::Mat& earlier = grey.images().at(earlier_ns);
  const double noise_levels = MeasureImageQuality(earlier, cv::Mat()).noise_levels;
  return ChangedShare(earlier, grey.images().rbegin()->second, noise_levels) < kMaxChangedShare;
}

/// Forgets the image before the newest one when between the last that is kept and the newest one
/// nothing moved: a standstill does not push the drive out of the buffer.
void CameraTracker::Impl::ForgetStill() {
  const auto& images = grey.images();
  if (images.size() < 2) {
    moved_stamp_ns = images.rbegin()->first;
    return;
  }
  const Timestamp previous_ns = std::next(images.rbegin())->first;
  if (previous_ns <= moved_stamp_ns) return;
  const auto motion_px = live->TypicalMotionPx(moved_stamp_ns);
  if (!motion_px || *motion_px >= options.buffer.min_motion_px || !LooksAlike(previous_ns)) {
    moved_stamp_ns = previous_ns;
    return;
  }
  live->ForgetPrevious();
  colour.Remove(previous_ns);
  grey.Remove(previous_ns);
  ++num_images_still;
}

/// The final tracks from what was followed, or from `followed_share` of it.
void CameraTracker::Impl::Register(const std::vector<LiveTrack>& followed, double followed_share,
                                   const cv::Mat& seen, const ImageQuality& quality,
                                   CameraSegment* segment) const {
  const std::map<Timestamp, cv::Mat>* images = &grey.images();
  ImageQuality registered_quality = quality;
  TrackingOptions adapted = options;
  ImageStore smoothed(MaxBytes(options));
  const bool is_noisy = IsNoisy(quality, options.noisy);
  if (is_noisy) {
    const Status status = Smooth(grey.images(), options.noisy.blur_px, &smoothed);
    if (status.ok()) {
      images = &smoothed.images();
      registered_quality = AfterSmoothing(quality, options.noisy);
      adapted = ForNoisyImages(options);
    } else {
      segment->warnings.push_back(name +
                                  ": noisy images are registered as they are: " + status.message());
    }
  }
  segment->tracks = RegisterAndVerify(followed, *model, *images, seen, registered_quality, adapted);
  const double few_observations = followed_share * options.registration.few_tracks_share *
                                  options.detection.max_features *
                                  static_cast<double>(images->size());
  if (!is_noisy && static_cast<double>(NumObservations(segment->tracks)) < few_observations) {
    segment->tracks = RegisterAndVerify(followed, *model, *images, seen, registered_quality,
                                        ForFewTracks(adapted));
  }
  if (options.verification.enough_tracks > 0) {
    DropShortest(static_cast<std::size_t>(options.verification.enough_tracks) * images->size(),
                 &segment->tracks);
  }
}

CameraTracker::CameraTracker(std::string name, CameraModelPtr model, const TrackingOptions& options,
                             const cv::Mat& mask)
    : impl_(std::make_unique<Impl>(std::move(name), std::move(model), options, mask.clone())) {}

CameraTracker::~CameraTracker() = default;
CameraTracker::CameraTracker(CameraTracker&&) noexcept = default;
CameraTracker& CameraTracker::operator=(CameraTracker&&) noexcept = default;

void CameraTracker::Reset() {
  impl_ = std::make_unique<Impl>(impl_->name, impl_->model, impl_->options, impl_->mask);
}

Result<FrameTracking> CameraTracker::AddImage(const GrayImage& image) {
  Impl& impl = *impl_;
  SCENECALIB_RETURN_IF_ERROR(impl.Check(image));
  if (!impl.live) impl.live.emplace(impl.model, impl.options, impl.mask);
  const GrayImage kept{
      image.stamp_ns, image.pixels.clone(), {}};  // the caller may reuse its buffer
  const FrameTracking frame = impl.live->Add(kept);

  impl.Keep(kept, image.colour);
  impl.ForgetStill();
  impl.last_stamp_ns = kept.stamp_ns;
  ++impl.num_images_in;
  impl.num_images_black += frame.is_black ? 1 : 0;
  impl.brightness_sum += frame.mean_brightness;
  return frame;
}

CameraSegment CameraTracker::Segment() const {
  const Impl& impl = *impl_;
  CameraSegment segment;
  const std::map<Timestamp, cv::Mat>& images = impl.grey.images();
  segment.images = images;
  segment.colour_images = impl.colour.images();
  segment.num_images_in = impl.num_images_in;
  segment.num_images_dropped_at_bound = impl.num_images_dropped;
  segment.num_images_still = impl.num_images_still;
  if (!impl.live) return segment;
  segment.mean_brightness = impl.brightness_sum / impl.num_images_in;
  if (!impl.store_status.ok()) {
    segment.warnings.push_back(impl.name + ": " + impl.store_status.message());
  }
  if (impl.num_images_black > 0) {
    segment.warnings.push_back(impl.name + ": " + std::to_string(impl.num_images_black) + " of " +
                               std::to_string(impl.num_images_in) + " images are black");
  }
  const VerificationOptions& verification = impl.options.verification;
  const cv::Mat mask = impl.live->Mask();
  const ImageQuality quality = TypicalQuality(images, mask);
  std::vector<LiveTrack> live = impl.live->Tracks();
  const std::size_t num_followed = NumObservations(live);
  const double duration_s =
      images.empty() ? 0.0 : SecondsBetween(images.begin()->first, images.rbegin()->first);
  live = Selected(std::move(live), duration_s, impl.options, *impl.model);
  const double registered_share = static_cast<double>(NumObservations(live)) /
                                  static_cast<double>(std::max<std::size_t>(1, num_followed));
  impl.Register(live, registered_share, mask, quality, &segment);
  if (segment.tracks.empty()) {
    segment.warnings.push_back(impl.name + ": no feature could be tracked in " +
                               std::to_string(impl.num_images_in) + " images");
  }
  const auto tracks_an_image = static_cast<std::size_t>(
      static_cast<double>(NumObservations(segment.tracks)) /
      (std::max(1e-6, registered_share) * static_cast<double>(images.size())));
  if (2 * impl.num_images_black < impl.num_images_in &&
      segment.mean_brightness < impl.options.flow.dark_mean &&
      tracks_an_image < static_cast<std::size_t>(verification.min_tracks_in_dark)) {
    segment.warnings.push_back(impl.name + ": too dark: mean grey value " +
                               std::to_string(std::lround(segment.mean_brightness)) + ", " +
                               std::to_string(tracks_an_image) + " verified tracks an image");
  }
  return segment;
}

cv::Mat CameraTracker::DebugImage() const {
  cv::Mat drawn;
  if (!impl_->live) return drawn;
  cv::cvtColor(impl_->grey.images().rbegin()->second, drawn, cv::COLOR_GRAY2BGR);
  const auto to_point = [](const Eigen::Vector2d& pixel) {
    return cv::Point2f(static_cast<float>(pixel.x()), static_cast<float>(pixel.y()));
  };
  constexpr std::size_t kTail = 10;
  for (const ActiveTrack& active : impl_->live->active()) {
    if (active.num_missed > 0) continue;
    const auto& observations = active.track.observations;
    const std::size_t n = observations.size();
    // Young tracks red, old ones green.
    const double age = std::min(1.0, static_cast<double>(n) / 20.0);
    const cv::Scalar colour(0, 255 * age, 255 * (1.0 - age));
    for (std::size_t k = n > kTail ? n - kTail : 1; k < n; ++k) {
      cv::line(drawn, to_point(observations[k - 1].pixel), to_point(observations[k].pixel), colour,
               1, cv::LINE_AA);
    }
    cv::circle(drawn, to_point(observations.back().pixel), 2, colour, cv::FILLED, cv::LINE_AA);
  }
  return drawn;
}

}  // namespace scenecalib
