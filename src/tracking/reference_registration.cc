#include "scenecalib/tracking/reference_registration.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>

#include "scenecalib/tracking/observation_noise.h"
#include "scenecalib/tracking/patch_registration.h"

namespace scenecalib {
namespace {

/// Noise that reading through the B-spline kernel leaves, as a share of the pixels' own.
constexpr double kSmoothedNoise = 0.5;

constexpr double kPartConvergencePx = 0.03;

/// Stated deviations by which the centre of a patch may be off without meaning anything.
constexpr double kCenterSigmas = 2.0;

/// Share of the correlation asked for that a registration must have reached after some iterations.
constexpr double kHopelessNcc = 0.6;

/// Observations [begin, end) that share a reference.
struct Span {
  int begin = 0;
  int end = 0;
  int reference = 0;
};

/// The reference with the most neighbours, contiguous in time, within the scale limit; among equals
/// the one nearest to the middle of its span, so that the change of view is shared by both ends.
Span ChooseReference(const LiveTrack& track, int begin, int end, double max_scale) {
  const auto& observations = track.observations;
  Span best;
  int best_offset = 0;
  for (int reference = begin; reference < end; ++reference) {
    const Eigen::Matrix2d first_from_reference =
        observations[reference].affine_from_first.inverse();
    const auto is_near = [&](int i) {
      return ScaleChange(observations[i].affine_from_first * first_from_reference) <= max_scale;
    };
    Span span{reference, reference + 1, reference};
    while (span.begin > begin && is_near(span.begin - 1)) --span.begin;
    while (span.end < end && is_near(span.end)) ++span.end;
    const int size = span.end - span.begin;
    const int offset = std::abs(2 * reference + 1 - span.begin - span.end);
    const int best_size = best.end - best.begin;
    if (size > best_size || (size == best_size && offset < best_offset)) {
      best = span;
      best_offset = offset;
    }
  }
  return best;
}

class TrackRegistrar {
 public:
  TrackRegistrar(const LiveTrack& live, const ReferenceMatcher& matcher, int min_observations,
                 const RegistrationOptions& options)
      : live_(live), matcher_(matcher), min_observations_(min_observations), options_(options) {}

  std::vector<RegisteredTrack> Run() {
    RegisterRange(0, static_cast<int>(live_.observations.size()));
    return std::move(tracks_);
  }

 private:
  /// Registers the best span of the range, then what lies before and after what it could accept.
  void RegisterRange(int begin, int end) {
    if (end - begin < min_observations_ || num_attempts_ >= kMaxTrackParts) return;
    const Span span = ChooseReference(live_, begin, end, options_.max_scale);
    RegisteredTrack registered;
    Track& track = registered.track;
    track.id = live_.id * kMaxTrackParts + num_attempts_;
    ++num_attempts_;
    int first = span.reference;
    int last = span.reference;
    if (span.end - span.begin >= min_observations_) {
      RegisterSpan(span, &registered, &first, &last);
    }
    if (static_cast<int>(track.observations.size()) >= min_observations_) {
      tracks_.push_back(std::move(registered));
    }
    RegisterRange(begin, first);
    RegisterRange(last + 1, end);
  }

  void RegisterSpan(const Span& span, RegisteredTrack* registered, int* first, int* last) const {
    Track* track = &registered->track;
    const LiveObservation& reference = live_.observations[span.reference];
    const Eigen::Vector2d center_px(std::round(reference.pixel.x()),
                                    std::round(reference.pixel.y()));
    auto view = matcher_.Prepare(reference.stamp_ns, center_px);
    if (!view) return;
    const std::map<int, ReferenceMatch> matches = MatchSpan(span, &*view);
    Eigen::Matrix2d covariance_sum = Eigen::Matrix2d::Zero();
    for (int i = span.begin; i < span.end; ++i) {
      TrackObservation observation;
      observation.stamp_ns = live_.observations[i].stamp_ns;
      const auto match = matches.find(i);
      if (i == span.reference) {
        observation.pixel = center_px;
        track->reference = static_cast<int>(track->observations.size());
      } else if (match != matches.end()) {
        const PatchMatch& found = match->second.match;
        observation.pixel = found.warp.center_px;
        observation.covariance_px2 = found.covariance_px2;
        if (match->second.is_core) track->patch_radius_px = options_.core_radius_px;
        const Eigen::Matrix2d to_reference = found.warp.affine.inverse();
        covariance_sum += to_reference * observation.covariance_px2 * to_reference.transpose();
      } else {
        continue;
      }
      track->observations.push_back(observation);
      const Eigen::Matrix2d affine =
          match != matches.end() ? match->second.match.warp.affine : Eigen::Matrix2d::Identity();
      if (track->observations.size() == 1) registered->first_from_reference = affine;
      registered->last_from_reference = affine;
      *first = std::min(*first, i);
      *last = std::max(*last, i);
    }
    const int num_matches = static_cast<int>(track->observations.size()) - 1;
    if (num_matches > 0) {
      ShareMatchCovariance(covariance_sum / num_matches, options_.sigma_floor_px, track);
    }
  }

  std::map<int, ReferenceMatch> MatchSpan(const Span& span, ReferenceView* view) const {
    const LiveObservation& reference = live_.observations[span.reference];
    const Eigen::Matrix2d first_from_reference = reference.affine_from_first.inverse();
    std::map<int, ReferenceMatch> matches;
    for (const bool forward : {false, true}) {
      const int step = forward ? 1 : -1;
      const int end = forward ? span.end : span.begin - 1;
      // Parallax grows with the distance from the reference view: once the parts of the patch
      // agree, coming from the far end, they do nearer too.
      bool may_disagree = true;
      for (int i = end - step; i != span.reference; i -= step) {
        const LiveObservation& live = live_.observations[i];
        PatchWarp initial;
        initial.affine = live.affine_from_first * first_from_reference;
        initial.center_px = live.pixel + initial.affine * (view->center_px - reference.pixel);
        auto match = matcher_.MatchWhole(view, initial, live.stamp_ns);
        if (match && may_disagree) {
          if (matcher_.PartsDisagree(view, match->warp, live.stamp_ns)) {
            initial = match->warp;
            match.reset();
          } else {
            may_disagree = false;
          }
        }
        const bool is_core = !match;
        if (is_core) match = matcher_.MatchCore(view, initial, live.stamp_ns);
        if (match) matches.emplace(i, ReferenceMatch{*match, is_core});
      }
    }
    return matches;
  }

  const LiveTrack& live_;
  const ReferenceMatcher& matcher_;
  const int min_observations_;
  const RegistrationOptions& options_;
  std::vector<RegisteredTrack> tracks_;
  int num_attempts_ = 0;
};

}  // namespace

ReferenceMatcher::ReferenceMatcher(const std::map<Timestamp, cv::Mat>& images, const cv::Mat& mask,
                                   const ImageQuality& quality, const RegistrationOptions& options)
    : images_(images),
      mask_(mask),
      options_(options),
      noise_levels_(kSmoothedNoise * quality.noise_levels),
      max_residual_levels_(std::hypot(options.max_residual_noise * noise_levels_,
                                      options.max_residual_contrast * quality.contrast)) {}

std::optional<ReferenceView> ReferenceMatcher::Prepare(Timestamp stamp_ns,
                                                       const Eigen::Vector2d& center_px) const {
  if (!IsAllowed(center_px)) return std::nullopt;
  auto whole = ReferencePatch::Create(images_.at(stamp_ns), center_px, options_.radius_px,
                                      WarpFreedom::kAffine);
  if (!whole) return std::nullopt;
  return ReferenceView{stamp_ns, center_px, std::move(*whole), std::nullopt, true, std::nullopt};
}

std::optional<PatchMatch> ReferenceMatcher::MatchWhole(ReferenceView* view,
                                                       const PatchWarp& initial,
                                                       Timestamp stamp_ns) const {
  return Judge(view->whole.Register(images_.at(stamp_ns), initial, Limits()),
               {options_.max_sigma_px, max_residual_levels_});
}

std::optional<PatchMatch> ReferenceMatcher::MatchCore(ReferenceView* view, const PatchWarp& initial,
                                                      Timestamp stamp_ns) const {
  if (!view->core && view->has_core) {
    view->core = ReferencePatch::Create(images_.at(view->stamp_ns), view->center_px,
                                        options_.core_radius_px, WarpFreedom::kAffine);
    view->has_core = view->core.has_value();
  }
  if (!view->core) return std::nullopt;
  return Judge(view->core->Register(images_.at(stamp_ns), initial, Limits()),
               {options_.max_core_sigma_px, options_.max_core_residual * max_residual_levels_});
}

PatchRegistrationLimits ReferenceMatcher::Limits() const {
  return {options_.max_iterations, options_.convergence_px, options_.max_correction_px,
          kHopelessNcc * options_.min_ncc};
}

std::optional<PatchMatch> ReferenceMatcher::Judge(const std::optional<PatchMatch>& found,
                                                  const Criteria& criteria) const {
  if (!found ||
      found->ncc < options_.min_ncc * ReachableNcc(found->reference_sigma, noise_levels_) ||
      found->residual_sigma > criteria.max_residual_levels * std::hypot(1.0, found->gain) ||
      !IsAllowed(found->warp.center_px) ||
      ScaleChange(found->warp.affine) > 1.2 * options_.max_scale) {
    return std::nullopt;
  }
  PatchMatch match = *found;
  match.covariance_px2 *= options_.noise_correlation;
  const double max_variance = criteria.max_sigma_px * criteria.max_sigma_px;
  // A pixel of a view from afar is several of the reference: the match has to be certain in both.
  const Eigen::Matrix2d to_reference = match.warp.affine.inverse();
  const Eigen::Matrix2d in_reference =
      to_reference * match.covariance_px2 * to_reference.transpose();
  // The trace bounds the larger eigenvalue from above, twice the determinant's root from below.
  const double variance = std::max(match.covariance_px2.trace(), in_reference.trace());
  if (!(variance < max_variance)) return std::nullopt;
  const double noise_variance = noise_levels_ * noise_levels_ * (1.0 + match.gain * match.gain);
  const double misfit_share =
      std::max(0.0, 1.0 - noise_variance / (match.residual_sigma * match.residual_sigma));
  if (misfit_share * variance > options_.max_misfit_px * options_.max_misfit_px) {
    return std::nullopt;
  }
  return match;
}

std::optional<ReferenceMatch> ReferenceMatcher::Match(ReferenceView* view, const PatchWarp& initial,
                                                      Timestamp stamp_ns) const {
  const auto whole = MatchWhole(view, initial, stamp_ns);
  if (whole && !PartsDisagree(view, whole->warp, stamp_ns)) return ReferenceMatch{*whole, false};
  const auto core = MatchCore(view, whole ? whole->warp : initial, stamp_ns);
  if (!core) return std::nullopt;
  return ReferenceMatch{*core, true};
}

bool ReferenceMatcher::PartsDisagree(ReferenceView* view, const PatchWarp& warp,
                                     Timestamp stamp_ns) const {
  if (!view->parts) view->parts = PartsOf(*view);
  for (const ReferenceView::Part& part : *view->parts) {
    PatchWarp initial = warp;
    initial.center_px = warp(part.offset_px);
    const auto match = part.patch.Register(
        images_.at(stamp_ns), initial,
        {options_.max_iterations, kPartConvergencePx, 2.0 * options_.max_part_shift_px});
    if (!match) return true;
    const double shift_px = (match->warp.center_px - initial.center_px).norm();
    if (shift_px > options_.max_part_shift_px) return true;
    if (!part.offset_px.isZero()) continue;
    const double sigma_px =
        std::sqrt(0.5 * options_.noise_correlation * match->covariance_px2.trace());
    if (shift_px > std::hypot(options_.max_center_shift_px, kCenterSigmas * sigma_px)) return true;
  }
  return false;
}

std::vector<ReferenceView::Part> ReferenceMatcher::PartsOf(const ReferenceView& view) const {
  const int radius_px = options_.radius_px / 2;
  std::vector<ReferenceView::Part> parts;
  for (const Eigen::Vector2d& direction :
       {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(-1.0, -1.0), Eigen::Vector2d(-1.0, 1.0),
        Eigen::Vector2d(1.0, -1.0), Eigen::Vector2d(1.0, 1.0)}) {
    const Eigen::Vector2d offset_px = radius_px * direction;
    auto patch = PatchTemplate::Create(images_.at(view.stamp_ns), view.center_px + offset_px,
                                       radius_px, WarpFreedom::kShift);
    if (patch) parts.push_back({offset_px, std::move(*patch)});
  }
  return parts;
}

bool ReferenceMatcher::IsAllowed(const Eigen::Vector2d& pixel) const {
  const int x = static_cast<int>(std::lround(pixel.x()));
  const int y = static_cast<int>(std::lround(pixel.y()));
  return x >= 0 && y >= 0 && x < mask_.cols && y < mask_.rows && mask_.at<uchar>(y, x) != 0;
}

double ScaleChange(const Eigen::Matrix2d& affine) {
  // Singular values of a 2x2 matrix in closed form.
  const double sum = affine.squaredNorm();
  const double determinant = std::abs(affine.determinant());
  const double root = std::sqrt(std::max(0.0, sum * sum - 4.0 * determinant * determinant));
  const double largest = std::sqrt(0.5 * (sum + root));
  const double smallest = determinant / std::max(largest, 1e-12);
  return std::max(largest, 1.0 / std::max(smallest, 1e-12));
}

std::vector<RegisteredTrack> RegisterAgainstReference(const std::vector<LiveTrack>& live_tracks,
                                                      const std::map<Timestamp, cv::Mat>& images,
                                                      const cv::Mat& mask,
                                                      const ImageQuality& quality,
                                                      int min_observations,
                                                      const RegistrationOptions& options) {
  const ReferenceMatcher matcher(images, mask, quality, options);
  std::vector<std::vector<RegisteredTrack>> parts(live_tracks.size());
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, live_tracks.size(), 16),
      [&](const tbb::blocked_range<std::size_t>& range) {
        for (std::size_t i = range.begin(); i < range.end(); ++i) {
          parts[i] = TrackRegistrar(live_tracks[i], matcher, min_observations, options).Run();
        }
      });
  std::vector<RegisteredTrack> tracks;
  for (auto& part : parts) {
    std::move(part.begin(), part.end(), std::back_inserter(tracks));
  }
  std::sort(tracks.begin(), tracks.end(), [](const RegisteredTrack& a, const RegisteredTrack& b) {
    return a.track.id < b.track.id;
  });
  return tracks;
}

}  // namespace scenecalib
