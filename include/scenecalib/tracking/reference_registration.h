#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <opencv2/core.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "scenecalib/base/timestamp.h"
#include "scenecalib/tracking/image_quality.h"
#include "scenecalib/tracking/patch_registration.h"
#include "scenecalib/tracking/track.h"
#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// A sighting as the live tracker left it.
struct LiveObservation {
  Timestamp stamp_ns = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  /// Offsets around the track's first pixel -> offsets around this one.
  Eigen::Matrix2d affine_from_first = Eigen::Matrix2d::Identity();
};

/// A track before its final registration: close to the truth, but it may have drifted.
struct LiveTrack {
  std::int64_t id = 0;
  std::vector<LiveObservation> observations;
};

/// A track after its registration, with what is needed to carry it on.
struct RegisteredTrack {
  Track track;
  Eigen::Matrix2d first_from_reference = Eigen::Matrix2d::Identity();  ///< affine, first sighting
  Eigen::Matrix2d last_from_reference = Eigen::Matrix2d::Identity();   ///< affine, last sighting
};

/// The patch of a track's reference view: the whole of it, its parts and its core.
struct ReferenceView {
  /// A quarter of the patch, or its centre, as large as a quarter.
  struct Part {
    Eigen::Vector2d offset_px = Eigen::Vector2d::Zero();  ///< of its middle
    PatchTemplate patch;
  };
  Timestamp stamp_ns = 0;
  Eigen::Vector2d center_px = Eigen::Vector2d::Zero();
  ReferencePatch whole;
  /// Made when first needed.
  std::optional<ReferencePatch> core;
  bool has_core = true;
  std::optional<std::vector<Part>> parts;  ///< those with structure
};

/// A sighting as found by registration.
struct ReferenceMatch {
  PatchMatch match;
  bool is_core = false;  ///< only the core of the patch matches
};

/// The registration of single sightings against a reference view, and its criteria.
class ReferenceMatcher {
 public:
  /// `images` and `mask` must outlive this.
  ReferenceMatcher(const std::map<Timestamp, cv::Mat>& images, const cv::Mat& mask,
                   const ImageQuality& quality, const RegistrationOptions& options);

  /// The patch around a whole pixel of an image; none where there is too little to see.
  std::optional<ReferenceView> Prepare(Timestamp stamp_ns, const Eigen::Vector2d& center_px) const;

  /// None when the whole patch does not match. The covariance is that of the match, both images'
  /// noise.
  std::optional<PatchMatch> MatchWhole(ReferenceView* view, const PatchWarp& initial,
                                       Timestamp stamp_ns) const;

  /// The core alone, where a depth edge or an occluder crosses the whole: it has to be much more
  /// certain and alike.
  std::optional<PatchMatch> MatchCore(ReferenceView* view, const PatchWarp& initial,
                                      Timestamp stamp_ns) const;

  /// True where the quarters of a reference patch move unlike the whole, or where its centre, which
  /// is what the track stands for, is elsewhere than the whole puts it by more than noise.
  bool PartsDisagree(ReferenceView* view, const PatchWarp& warp, Timestamp stamp_ns) const;

  /// The whole where its parts agree with it, else the core.
  std::optional<ReferenceMatch> Match(ReferenceView* view, const PatchWarp& initial,
                                      Timestamp stamp_ns) const;

 private:
  struct Criteria {
    double max_sigma_px;
    double max_residual_levels;
  };
  PatchRegistrationLimits Limits() const;
  std::optional<PatchMatch> Judge(const std::optional<PatchMatch>& match,
                                  const Criteria& criteria) const;
  std::vector<ReferenceView::Part> PartsOf(const ReferenceView& view) const;
  bool IsAllowed(const Eigen::Vector2d& pixel) const;

  const std::map<Timestamp, cv::Mat>& images_;
  const cv::Mat& mask_;
  RegistrationOptions options_;
  double noise_levels_;         ///< as patches are read
  double max_residual_levels_;  ///< that each of the two images may contribute
};

/// Largest factor by which an affine map stretches or shrinks any direction, >= 1.
double ScaleChange(const Eigen::Matrix2d& affine);

/// The final tracks: every observation registered directly, with a free affine warp, gain and bias,
/// against the patch of one reference view near the middle of its track, so that no error can
/// accumulate along the track. Observations that do not match the reference are dropped, among them
/// those that leave a residual beyond noise or whose parts disagree: there the patch straddles a
/// depth edge, and what it follows is not what lies at its centre; unless the patch's core alone
/// matches well. Where the scale changes too much for one reference the track is split, and the
/// parts are separate tracks (they see points near each other, but not the same one). The scene
/// point of a track is the whole pixel nearest to where the live tracker was in the reference view.
///
/// Ids are live id * kMaxTrackParts + part. Parallel over tracks; the result does not depend on the
/// number of threads. `quality` is what the images are worth on the whole; `mask` is zero where an
/// observation may not lie; every stamp must have its image.
constexpr int kMaxTrackParts = 8;
std::vector<RegisteredTrack> RegisterAgainstReference(const std::vector<LiveTrack>& live_tracks,
                                                      const std::map<Timestamp, cv::Mat>& images,
                                                      const cv::Mat& mask,
                                                      const ImageQuality& quality,
                                                      int min_observations,
                                                      const RegistrationOptions& options);

}  // namespace scenecalib
