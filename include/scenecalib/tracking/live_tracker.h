#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/sensor/measurements.h"
#include "scenecalib/tracking/image_flow.h"
#include "scenecalib/tracking/image_quality.h"
#include "scenecalib/tracking/new_features.h"
#include "scenecalib/tracking/patch_registration.h"
#include "scenecalib/tracking/reference_registration.h"
#include "scenecalib/tracking/scene_flow.h"
#include "scenecalib/tracking/static_regions.h"
#include "scenecalib/tracking/track.h"
#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// A track that is still being followed, with the patch it is compared with.
struct ActiveTrack {
  LiveTrack track;
  PatchTemplate patch;
  Eigen::Matrix2d patch_affine_from_first = Eigen::Matrix2d::Identity();
  /// Where it is in the newest image: the last observation, or where scene flow carried it since.
  LiveObservation place;
  int num_missed = 0;           ///< images since the last observation
  bool straddles_edge = false;  ///< not followed any more, only kept from being detected again
};

struct FeaturePrediction;

/// Features followed from image to image:
///   predict where each goes -> pyramidal Lucas-Kanade there and back on reduced images ->
///   registration of the patch against an earlier view of the same track, which stops drift and
///   chains the affine warp -> a second try, where the others' motion predicts it, for what was
///   lost (scene_flow.h), for some images to come -> drop what is fixed to the vehicle -> detect
///   new features where there is room.
/// The caller checks the images' size, type and order.
class LiveTracker {
 public:
  /// `mask` is zero where nothing of the scene is seen; empty: seen wherever the model reaches.
  LiveTracker(CameraModelPtr model, const TrackingOptions& options,
              const cv::Mat& mask = cv::Mat());

  /// `pixels` must stay unchanged while the tracker lives.
  FrameTracking Add(const GrayImage& image);

  /// How far features have moved in the image between an earlier one and the newest: a fifth of
  /// them moved further. None when too few were seen in both.
  std::optional<double> TypicalMotionPx(Timestamp since_ns) const;

  /// Takes back the image before the newest one: its sightings are dropped.
  void ForgetPrevious();

  /// Drops sightings up to this time, and what then is no track any more.
  void Forget(Timestamp stamp_ns);

  /// Finished tracks and those still being followed.
  std::vector<LiveTrack> Tracks() const;

  const std::vector<ActiveTrack>& active() const { return active_; }

  /// 255 where a whole patch sees the scene through the model and nothing is fixed to the vehicle.
  cv::Mat Mask() const { return open_.clone(); }

 private:
  void Follow(const GrayImage& image, const FlowPyramid& pyramid, FrameTracking* frame);
  /// Looks for features, indices into active(), around their predictions, through so many levels of
  /// the pyramid, and registers what is found; returns those that are lost.
  std::vector<std::size_t> Search(const GrayImage& image, const FlowPyramid& pyramid,
                                  int num_levels, const std::vector<FeaturePrediction>& predicted,
                                  const std::vector<std::size_t>& features);
  bool Extend(const GrayImage& image, const FeaturePrediction& predicted, double min_ncc,
              ActiveTrack* active_track) const;
  bool Rescue(const GrayImage& image, const FlowPyramid& pyramid, const PatchWarp& step,
              ActiveTrack* active_track) const;
  bool FindAgain(const GrayImage& image, const FlowPyramid& pyramid,
                 ActiveTrack* active_track) const;
  void Learn(const FlowPyramid& pyramid, const std::vector<char>& is_extended);
  void EstimateSceneFlow(const std::vector<char>& is_extended);
  void RemoveDuplicates(double scale, FrameTracking* frame);
  bool RemoveFixed(FrameTracking* frame);
  void RemoveStatic(const FlowPyramid& pyramid, bool is_allowed_changed, FrameTracking* frame);
  void Detect(const GrayImage& image, const FlowPyramid& pyramid, FrameTracking* frame);
  /// Ends the tracks that are not kept; `forget` drops them altogether.
  int EndOthers(const std::vector<char>& is_kept, bool forget);

  CameraModelPtr model_;
  TrackingOptions options_;
  cv::Mat domain_;   ///< 255 where a whole patch sees the scene through the model
  cv::Mat allowed_;  ///< the same, without features found to be fixed to the vehicle
  cv::Mat open_;     ///< the same, without regions that never move
  StaticRegions static_regions_;
  NewFeatures new_features_;
  std::vector<ActiveTrack> active_;
  std::vector<LiveTrack> finished_;
  std::size_t num_finished_before_ = 0;  ///< the newest image
  std::int64_t next_id_ = 0;

  int num_images_ = 0;
  double noise_levels_ = 0.0;         ///< of the newest image, as patches are read
  double max_residual_levels_ = 0.0;  ///< that the newest image may contribute to a registration's
  cv::Mat previous_image_;
  FlowPyramid previous_pyramid_;
  bool previous_equalised_ = false;
  Timestamp previous_stamp_ns_ = 0;  ///< of the newest image, once it is taken in
  Timestamp before_previous_stamp_ns_ = 0;
  std::optional<SceneFlow> scene_flow_;  ///< between the last two images
};

}  // namespace scenecalib
