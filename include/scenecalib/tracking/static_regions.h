#pragma once

#include <Eigen/Core>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "scenecalib/tracking/image_flow.h"
#include "scenecalib/tracking/scene_flow.h"
#include "scenecalib/tracking/tracking_options.h"

namespace scenecalib {

/// Finds the parts of the image that never move: the vehicle's own bonnet and mirrors, a fisheye's
/// dark rim, dirt, a logo.
///
/// An image is looked at tile by tile, and only where the scene would have moved since the tile was
/// last looked at: while the vehicle stands nothing is learnt. Gradients that stay in place do not
/// vanish in their mean over time, those of a passing scene do; the tile's share of the gradient's
/// energy that is in the mean tells the two apart. Only gradients along the scene's motion count,
/// because an edge along it (a kerb, a lane marking straight ahead) looks alike all the time. Tiles
/// without gradients (paint, but also sky) are static only where static ones enclose them.
///
/// What is reflected in the bonnet moves, and is found only where it is fainter than what is fixed.
/// A thing that moves along with the vehicle for long is static too, until it leaves.
class StaticRegions {
 public:
  /// `domain`: zero where nothing of the scene is seen.
  StaticRegions(const cv::Mat& domain, const StaticRegionOptions& options);

  /// Takes in an image, `num_steps` images after the last one taken in. `flow` leads into it from
  /// the image before; null where no motion is known. True when the mask changed.
  bool Add(const FlowPyramid& pyramid, const SceneFlow* flow, int num_steps);

  /// 255 where static, as large as the images; empty while nothing is.
  const cv::Mat& mask() const { return mask_; }

 private:
  /// What is known of a tile, as means over the images in which it was looked at.
  struct Tile {
    int num_samples = 0;
    Eigen::Matrix2d energy = Eigen::Matrix2d::Zero();     ///< of gradients
    Eigen::Matrix2d direction = Eigen::Matrix2d::Zero();  ///< of the scene's motion
    Eigen::Vector2d motion_px = Eigen::Vector2d::Zero();  ///< of the scene since the last look
  };
  enum class Verdict : unsigned char { kUnknown, kMoving, kEmpty, kStatic };

  void SetUp(const FlowPyramid& pyramid);
  std::vector<std::optional<Eigen::Vector2d>> Steps(const SceneFlow& flow, double scale) const;
  void Sample(const cv::Mat& gradients, const cv::Rect& area, Tile* tile);
  Verdict Judge(const cv::Rect& area, const Tile& tile) const;
  bool UpdateMask();
  cv::Rect Area(int column, int row) const;

  cv::Mat domain_;
  StaticRegionOptions options_;
  double scale_ = 1.0;  ///< pixels of the image per pixel of the tiles
  cv::Size size_;       ///< of the reduced images
  int columns_ = 0;
  int rows_ = 0;
  std::vector<Tile> tiles_;    ///< row by row
  cv::Mat mean_gradients_;     ///< CV_32FC2, over a tile's samples
  std::vector<char> is_seen_;  ///< tiles inside the domain
  cv::Mat1b static_tiles_;     ///< of the mask
  cv::Mat mask_;
};

}  // namespace scenecalib
