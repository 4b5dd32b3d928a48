#pragma once

#include <Eigen/Core>
#include <optional>
#include <utility>
#include <vector>

#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/tracking/patch_registration.h"
#include "scenecalib/tracking/relative_motion.h"

namespace scenecalib {

/// Where pixels of one image go in the next, from the features already followed between the two.
///
/// The camera's motion (up to scale) gives every followed feature an inverse range. On a plane the
/// inverse range is linear in the unit ray, so a linear fit to a pixel's nearest features carries
/// over to places where nothing could be followed yet: the near road, whose motion is too large and
/// too stretched to be found by searching. Predictions are to be verified in the image.
class SceneFlow {
 public:
  /// `pixels` are (before, after). None when too few agree with one motion or the features hardly
  /// moved. `before` is the flow between the images before, if there is one.
  static std::optional<SceneFlow> Estimate(
      const CameraModel& model,
      const std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>>& pixels, double min_motion_px,
      const RelativeMotionOptions& options, const SceneFlow* before = nullptr);

  /// The warp of a pixel's surroundings (first order); none where it would leave the image.
  std::optional<PatchWarp> Predict(const Eigen::Vector2d& pixel) const;

  /// Where a feature that this flow took from `before_px` to `after_px` goes with the step after
  /// it, were that the same motion, `ratio` times as long. None where it did not move as the scene
  /// does, or leaves what the camera sees.
  std::optional<Eigen::Vector2d> Continue(const Eigen::Vector2d& before_px,
                                          const Eigen::Vector2d& after_px, double ratio) const;

 private:
  struct Support {
    Eigen::Vector2d pixel;
    Eigen::Vector3d ray;
    double inverse_range = 0.0;  ///< in units of the step's length
    double weight = 0.0;         ///< of the inverse range: the ray's angle to the motion, squared
  };

  SceneFlow(const CameraModel* model, RelativeMotion motion)
      : model_(model), motion_(std::move(motion)) {}

  /// Of a point whose rays these are, the first one rotated into the second camera's frame.
  double InverseRange(const Eigen::Vector3d& rotated_ray,
                      const Eigen::Vector3d& ray_in_second) const;
  void IndexSupports();
  void GatherNearest(const Eigen::Vector2d& pixel,
                     std::vector<std::pair<double, std::size_t>>* nearest) const;
  std::optional<Eigen::Vector3d> FitInverseRange(const Eigen::Vector2d& pixel) const;

  const CameraModel* model_;  ///< must outlive this
  RelativeMotion motion_;
  std::vector<Support> supports_;  ///< sorted by cell
  /// A grid over the image: where each cell's supports begin, and one past the last.
  double cell_px_ = 1.0;
  int columns_ = 1;
  int rows_ = 1;
  std::vector<std::size_t> cell_begin_;
};

}  // namespace scenecalib
