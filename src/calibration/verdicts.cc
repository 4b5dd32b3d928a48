#include "verdicts.h"

#include <cmath>
#include <iomanip>
#include <sstream>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kDegPerRad = 57.29577951308232;
/// A lens that is off by more than both is told of.
constexpr double kMisfit_px = 0.5;
constexpr double kMisfitSigmas = 4.0;
/// Stamps likewise. On a drive that hardly changes its speed a lidar's own errors pass for a
/// clock's, by five standard deviations on kitti_0009 (docs/accuracy.md).
constexpr double kMisfitClock_s = 1e-3;
constexpr double kMisfitClockSigmas = 8.0;
/// A camera whose stamps, or whose last row's time, are off by more than both is refused.
constexpr double kBadClock_s = 5e-3;
constexpr double kBadClockSigmas = 10.0;

std::string Text(double value, int digits) {
  std::ostringstream stream;
  stream << std::fixed << std::setprecision(digits) << value;
  return stream.str();
}

bool IsMisfit(double change_s, double stddev_s, double min_s, double min_sigmas) {
  return std::abs(change_s) > min_s && std::abs(change_s) > min_sigmas * stddev_s;
}

}  // namespace

std::vector<std::string> Objections(const CameraConfig& initial, const CameraQuality& quality,
                                    const JointCameraEvidence& evidence, const HeldOutRms& held_out,
                                    const Rigid3& result, const AcceptanceOptions& options) {
  std::vector<std::string> reasons;
  if (quality.num_inlier_tracks < options.min_inlier_tracks) {
    reasons.push_back("only " + std::to_string(quality.num_inlier_tracks) +
                      " inlier tracks, need " + std::to_string(options.min_inlier_tracks) +
                      ": drive further, in daylight, past structure");
  }
  const int associated = evidence.num_tracks_by_outcome[0];
  if (quality.num_inlier_tracks < options.min_inlier_fraction * associated) {
    reasons.push_back("only " + std::to_string(quality.num_inlier_tracks) + " of " +
                      std::to_string(associated) + " tracks agree with the result");
  }
  const double angle_deg =
      kDegPerRad * RotationAngle(initial.lidar_from_camera.rotation, result.rotation);
  if (angle_deg > options.max_rotation_change_deg) {
    reasons.push_back("rotation moved by " + Text(angle_deg, 2) + " deg, more than " +
                      Text(options.max_rotation_change_deg, 2) + ": check the initial pose");
  }
  const double distance_m = (result.translation - initial.lidar_from_camera.translation).norm();
  if (distance_m > options.max_translation_change_m) {
    reasons.push_back("translation moved by " + Text(distance_m, 3) + " m, more than " +
                      Text(options.max_translation_change_m, 3) + ": check the initial pose");
  }
  if (!(held_out.after_px < held_out.before_px)) {
    reasons.push_back("held-out tracks do not fit better than with the initial values (" +
                      Text(held_out.before_px, 3) + " px before, " + Text(held_out.after_px, 3) +
                      " px after)");
  }
  return reasons;
}

std::vector<std::string> WeakDirections(const CameraStddev& stddev,
                                        const AcceptanceOptions& options) {
  static const char* const kAxes[] = {"right", "down", "forward"};
  static const char* const kTurns[] = {"pitch", "yaw", "roll"};
  std::vector<std::string> weak;
  for (int k = 0; k < 3; ++k) {
    if (stddev.translation_m[k] > options.weak_translation_m) {
      weak.push_back(std::string(kAxes[k]) + " offset weakly observable (stddev " +
                     Text(100.0 * stddev.translation_m[k], 1) +
                     " cm): drive curves and change speed");
    }
    if (stddev.rotation_rad[k] * kDegPerRad > options.weak_rotation_deg) {
      weak.push_back(std::string(kTurns[k]) + " weakly observable (stddev " +
                     Text(kDegPerRad * stddev.rotation_rad[k], 2) +
                     " deg): drive curves, or hold the intrinsics");
    }
  }
  return weak;
}

MisfitVerdict JudgeLens(const RadialMisfit& lens) {
  if (lens.edge_px < kMisfit_px || std::abs(lens.change) < kMisfitSigmas * lens.stddev) return {};
  return {"its lens does not fit its images: they ask for " + Text(lens.change, 4) + " (stddev " +
              Text(lens.stddev, 4) + ") more of the first radial coefficient, " +
              Text(lens.edge_px, 1) +
              " px at the image's border; calibrate the lens again, or set "
              "calibration.estimate_distortion",
          false};
}

MisfitVerdict JudgeShutter(const ClockMisfit& clock, const CameraConfig& initial) {
  const double line_time_s = clock.line_time_change_s;
  if (!IsMisfit(line_time_s, clock.line_time_stddev_s, kBadClock_s / initial.model->height_px(),
                kBadClockSigmas)) {
    return {};
  }
  const double given_s = initial.rolling_shutter_line_time_s.value_or(0.0);
  return {"its images are exposed row by row, about " + Text(1e6 * (given_s + line_time_s), 0) +
              " us or more from one to the next, and the rig file says " +
              (given_s == 0.0 ? "nothing of it" : Text(1e6 * given_s, 1) + " us") +
              ": give the sensor's line time as rolling_shutter_line_time_s",
          true};
}

MisfitVerdict JudgeTimeOffset(const ClockMisfit& clock, const CameraConfig& initial) {
  const double offset_s = clock.time_offset_change_s;
  const double stddev_s = clock.time_offset_stddev_s;
  if (!IsMisfit(offset_s, stddev_s, kMisfitClock_s, kMisfitClockSigmas)) return {};
  return {"its images do not fit their stamps: they ask for a time_offset_s of " +
              Text(1e3 * (initial.time_offset_s + offset_s), 1) + " ms (stddev " +
              Text(1e3 * stddev_s, 1) + "), the rig file says " +
              Text(1e3 * initial.time_offset_s, 1) +
              " ms; calibrate with --estimate-time-offset, or set the clocks",
          IsMisfit(offset_s, stddev_s, kBadClock_s, kBadClockSigmas)};
}

}  // namespace scenecalib
