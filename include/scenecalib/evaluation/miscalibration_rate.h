#pragma once

#include <atomic>
#include <map>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/base/status.h"
#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/mapping/ray_caster.h"
#include "scenecalib/mapping/scene_map.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

struct MiscalibrationOptions {
  double max_translation_m = 0.02;
  double max_rotation_deg = 0.2;
  int num_samples = 60;
  int num_times = 40;
  double pair_separation_s = 0.5;
  double max_stamp_difference_s = 0.1;
  int min_points = 200;
  int max_points = 4000;
  double smoothing_px = 0.9;
  bool free_other_axes = true;
  int seed = 1;
  void Visit(OptionVisitor& v) {
    v.Field("max_translation_m", &max_translation_m, {1e-4, 1.0}, "positions are moved by up to");
    v.Field("max_rotation_deg", &max_rotation_deg, {1e-3, 10.0}, "rotations are turned by up to");
    v.Field("num_samples", &num_samples, {1, 10000}, "perturbed poses per axis");
    v.Field(
        "num_times", &num_times, {0, 1000},
        "times, evenly over the recording, to look at; 0 computes no rates; fewer, but not less "
        "than 20, for many or large cameras");
    v.Field("pair_separation_s", &pair_separation_s, {0.01, 60.0},
            "between the two images of a pair of one camera");
    v.Field("max_stamp_difference_s", &max_stamp_difference_s, {1e-3, 10.0},
            "between an image and the time it stands for");
    v.Field("min_points", &min_points, {10, 1000000}, "surface points that both images must see");
    v.Field("max_points", &max_points, {10, 1000000}, "surface points compared per pair");
    v.Field("smoothing_px", &smoothing_px, {0.5, 20.0},
            "finest detail compared, standard deviation in pixels of the coarser camera");
    v.Field("free_other_axes", &free_other_axes,
            "judge each axis with the other five where they look best for the camera, so that an "
            "error on one does not show on the others; off is the paper");
    v.Field("seed", &seed, {0, 2147483647}, "of the perturbations");
  }
};

/// The cameras' classes of Table I, by the angle across their images' diagonal.
enum class FieldOfView { kNarrow, kMedium, kWide };
constexpr int kNumFieldsOfView = 3;
FieldOfView FieldOfViewOf(const CameraModel& camera);
/// "30 deg", "70, 120 deg", "200 deg".
const char* ToString(FieldOfView field_of_view);

/// The paper's Table I, the less diverse recordings: what its calibrations reached.
MiscalibrationRate PublishedRate(FieldOfView field_of_view);

/// The miscalibration rate of IV-A for every camera of the rig: the share of poses, perturbed along
/// one axis of the camera frame at a time, under which the map's points look more alike in pairs of
/// images than under the given pose, averaged over pairs of cameras. Zero is ideal, one half is
/// what a pose well off the optimum gives. x, y, z are right, down, forward; roll turns about
/// forward, pitch about right, yaw about down. A pair is two cameras at about the same time, of
/// which the judged one is perturbed; for a camera that overlaps with no other it is the camera at
/// two times, perturbed in both (it is one pose), which hardly shows shifts.
///
/// Differs from the paper (docs/math.md, section 13, says why):
/// - points lie on the map's surfaces, well away from edges, and are seen by both cameras;
/// - likeness is the truncated square difference of band-passed, contrast-normalised images;
/// - an axis is judged with the other five at the camera's own optimum (`free_other_axes`);
/// - all pairs of a camera are judged together, instead of an average over pairs.
///
/// `images` (CV_8UC1, by the camera's own stamps) is parallel to rig.cameras. A camera for which no
/// pair shares enough points has no rate. InvalidArgument for options out of range or lists of
/// different lengths. The same for any number of threads.
Result<std::vector<std::optional<MiscalibrationRate>>> ComputeMiscalibrationRates(
    const Rig& rig, const SceneMap& map,
    const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
    const MiscalibrationOptions& options);

/// The same for several rigs, parallel to them: quicker, because the images are prepared once.
Result<std::vector<std::vector<std::optional<MiscalibrationRate>>>> ComputeMiscalibrationRates(
    const std::vector<Rig>& rigs, const SceneMap& map,
    const std::vector<const std::map<Timestamp, cv::Mat>*>& images,
    const MiscalibrationOptions& options);

/// The same for rigs that become known one after the other. The map, its surfaces and the images
/// must outlive it.
class MiscalibrationRater {
 public:
  /// `images` is parallel to the cameras of every rig.
  MiscalibrationRater(const SceneMap& map, const RayCaster& surfaces,
                      std::vector<const std::map<Timestamp, cv::Mat>*> images,
                      const MiscalibrationOptions& options);
  ~MiscalibrationRater();

  /// The errors of ComputeMiscalibrationRates; Cancelled soon after `cancelled` became true. One
  /// rig at a time.
  Result<std::vector<std::optional<MiscalibrationRate>>> Rate(const Rig& rig,
                                                              const std::atomic<bool>& cancelled);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace scenecalib
