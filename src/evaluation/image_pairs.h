#pragma once

#include <Eigen/Core>
#include <atomic>
#include <map>
#include <opencv2/core.hpp>
#include <utility>
#include <vector>

#include "band_pass.h"
#include "scenecalib/evaluation/miscalibration_rate.h"
#include "scenecalib/mapping/ray_caster.h"

namespace scenecalib {

constexpr int kNumAxes = 6;  ///< x, y, z, pitch, yaw, roll: translations and rotations by axis
/// Of a camera's pixel by its scaled pose: one unit per axis is the largest perturbation.
using PixelByPose = Eigen::Matrix<float, 2, kNumAxes>;

/// Smoothed images by image and level; they do not depend on the rig.
using BandPassImages = std::map<std::pair<const cv::Mat*, int>, BandPassImage>;

/// What a pair's images show of the points that both see. Pixels move with the judged camera's pose
/// to first order: the perturbations are small.
struct Comparison {
  const BandPassImage* image = nullptr;
  const BandPassImage* other_image = nullptr;
  bool same_camera = false;
  std::vector<Eigen::Vector2f> pixels;
  std::vector<PixelByPose> pixels_by_pose;
  std::vector<Eigen::Vector2f> other_pixels;
  std::vector<PixelByPose> other_pixels_by_pose;  // only of the same camera
  std::vector<float> other_values;                // only of another camera
};

/// The comparisons of a rig, and which of them judge which camera.
struct ImagePairs {
  std::vector<Comparison> comparisons;
  std::vector<std::vector<std::size_t>> pairs_of_camera;  ///< by camera, indices of comparisons
};

/// `num_times`, or fewer where the smoothed images of a rig would take more than 0.8 GB; not less
/// than 20 for that.
int NumTimes(const Rig& rig, const MiscalibrationOptions& options);

/// Every camera with every other one at about the same time, at NumTimes times evenly over the
/// map's trajectory; a camera that shares views with no other one with itself a little later. A
/// pair is of points on the map's surfaces that both images see, and is left out with fewer than
/// `min_points`. `band_pass` keeps the smoothed images for the next rig; the comparisons point into
/// it. With few pairs or none where `cancelled` becomes true meanwhile.
ImagePairs CollectImagePairs(const Rig& rig, const SceneMap& map, const RayCaster& caster,
                             const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
                             const MiscalibrationOptions& options,
                             const std::atomic<bool>& cancelled, BandPassImages* band_pass);

}  // namespace scenecalib
