#include "scenecalib/pipeline/stretch_combination.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstdio>

#include "scenecalib/calibration/camera_calibration.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/sensor/lens_shape.h"

namespace scenecalib {
namespace {

using CameraVector = Eigen::Matrix<double, kNumCameraParameters, 1>;

const char* const kParameters[kNumCameraParameters] = {
    "shift right", "shift down",  "shift forward",     "turn pitch",        "turn yaw",
    "turn roll",   "focal scale", "principal point x", "principal point y", "time offset"};

template <typename... Args>
std::string Format(const char* format, Args... args) {
  char text[512];
  std::snprintf(text, sizeof(text), format, args...);
  return text;
}

/// A camera's change of parameters from the initial rig, in units of the prior's standard
/// deviations, and how well a stretch knows it.
struct Estimate {
  std::size_t stretch = 0;
  CameraVector value = CameraVector::Zero();
  CameraMatrix covariance = CameraMatrix::Identity();
  CameraMatrix information = CameraMatrix::Identity();
};

CameraVector PriorStddev(const CameraConfig& initial, const PriorOptions& options) {
  const CameraPrior prior = InitialPrior(initial, options);
  CameraVector stddev;
  stddev << prior.translation_m, prior.rotation_rad, prior.IntrinsicsStddev(), prior.time_offset_s;
  return stddev;
}

CameraVector StatedStddev(const CameraStddev& stddev) {
  CameraVector values;
  values << stddev.translation_m, stddev.rotation_rad, stddev.focal_scale,
      stddev.principal_point_px, stddev.time_offset_s;
  return values;
}

CameraVector Change(const CameraConfig& initial, const CameraConfig& refined) {
  const Eigen::Quaterniond camera_from_lidar = initial.lidar_from_camera.rotation.conjugate();
  CameraVector change;
  change << camera_from_lidar *
                (refined.lidar_from_camera.translation - initial.lidar_from_camera.translation),
      LogSo3(camera_from_lidar * refined.lidar_from_camera.rotation),
      FocalAtAxisPx(*refined.model) / FocalAtAxisPx(*initial.model) - 1.0,
      refined.model->tunable().principal_point_px - initial.model->tunable().principal_point_px,
      refined.time_offset_s - initial.time_offset_s;
  return change;
}

/// A parameter that was held has no deviation: it is taken to be known far better than by any
/// drive, so that it stays.
constexpr double kHeld = 1e-6;  // of the prior's deviation

Estimate MakeEstimate(std::size_t stretch, const CameraConfig& initial, const CameraConfig& refined,
                      const CameraStddev& stated, const CameraVector& prior_stddev) {
  constexpr double kNothingKnown = 10.0;
  Estimate estimate;
  estimate.stretch = stretch;
  estimate.value = Change(initial, refined).cwiseQuotient(prior_stddev);
  const CameraVector sigma =
      StatedStddev(stated).cwiseQuotient(prior_stddev).cwiseMax(kHeld).cwiseMin(kNothingKnown);
  estimate.covariance = sigma.asDiagonal() * stated.correlation * sigma.asDiagonal();
  // Nearly the same direction twice (principal point and rotation) must not make it singular.
  estimate.covariance.diagonal() *= 1.0 + 1e-9;
  estimate.information = estimate.covariance.ldlt().solve(CameraMatrix::Identity());
  return estimate;
}

/// Information-weighted mean; each estimate contains the prior, which is a unit matrix about zero.
Estimate Mean(const std::vector<Estimate>& estimates) {
  CameraMatrix information = CameraMatrix::Zero();
  CameraVector weighted = CameraVector::Zero();
  for (const Estimate& estimate : estimates) {
    information += estimate.information;
    weighted += estimate.information * estimate.value;
  }
  const Eigen::SelfAdjointEigenSolver<CameraMatrix> eigen(information);
  const double repeated = static_cast<double>(estimates.size()) - 1.0;
  const CameraVector known = (eigen.eigenvalues().array() - repeated).max(1.0).matrix();
  const CameraMatrix& axes = eigen.eigenvectors();
  Estimate mean;
  mean.information = axes * known.asDiagonal() * axes.transpose();
  mean.covariance = axes * known.cwiseInverse().asDiagonal() * axes.transpose();
  mean.value = mean.covariance * weighted;
  return mean;
}

/// Where an estimate is furthest from the mean of the others.
struct Disagreement {
  double sigmas = 0.0;
  int parameter = 0;
};

Disagreement WorstOf(const Estimate& estimate, const std::vector<Estimate>& others) {
  const Estimate mean = Mean(others);
  Disagreement worst;
  for (int k = 0; k < kNumCameraParameters; ++k) {
    const double variance = estimate.covariance(k, k) + mean.covariance(k, k);
    const double sigmas = std::abs(estimate.value[k] - mean.value[k]) / std::sqrt(variance);
    if (sigmas > worst.sigmas) worst = {sigmas, k};
  }
  return worst;
}

std::vector<Estimate> Without(const std::vector<Estimate>& estimates, std::size_t left_out) {
  std::vector<Estimate> others;
  for (std::size_t i = 0; i < estimates.size(); ++i) {
    if (i != left_out) others.push_back(estimates[i]);
  }
  return others;
}

/// Leaves out what contradicts the others, the worst first. An empty list when the last two
/// contradict each other.
std::vector<Estimate> Agreeing(std::vector<Estimate> estimates,
                               const std::vector<StretchCalibration>& stretches,
                               std::vector<std::string>* notes) {
  while (estimates.size() > 1) {
    Disagreement worst;
    std::size_t at = 0;
    for (std::size_t i = 0; i < estimates.size(); ++i) {
      const Disagreement found = WorstOf(estimates[i], Without(estimates, i));
      if (found.sigmas <= worst.sigmas) continue;
      worst = found;
      at = i;
    }
    if (worst.sigmas <= kMaxStretchSigmas) break;
    const std::string& name = stretches[estimates[at].stretch].name;
    if (estimates.size() == 2) {
      notes->push_back(Format(
          "%s and %s contradict each other: %s by %.1f sigma; calibrate on each alone and compare",
          stretches[estimates[0].stretch].name.c_str(),
          stretches[estimates[1].stretch].name.c_str(), kParameters[worst.parameter],
          worst.sigmas));
      return {};
    }
    notes->push_back(Format("%s is left out: it contradicts the others' %s by %.1f sigma",
                            name.c_str(), kParameters[worst.parameter], worst.sigmas));
    estimates = Without(estimates, at);
  }
  return estimates;
}

/// How many times larger the spread of the estimates is than their covariances say; at least one.
double SpreadOverStated(const std::vector<Estimate>& estimates, const Estimate& mean) {
  if (estimates.size() < 2) return 1.0;
  double sum = 0.0;
  for (const Estimate& estimate : estimates) {
    const CameraVector difference = estimate.value - mean.value;
    for (int k = 0; k < kNumCameraParameters; ++k) {
      sum += difference[k] * difference[k] / estimate.covariance(k, k);
    }
  }
  const double freedom = kNumCameraParameters * (static_cast<double>(estimates.size()) - 1.0);
  return std::max(1.0, std::sqrt(sum / freedom));
}

/// Mean change of the lens' radial coefficient; the result files do not tell how sure each one is.
double RadialChange(const CameraConfig& initial, const std::vector<StretchCalibration>& stretches,
                    const std::vector<Estimate>& used, std::size_t camera) {
  double sum = 0.0;
  for (const Estimate& estimate : used) {
    const CameraModel& refined = *stretches[estimate.stretch].result.rig.cameras[camera].model;
    // Of ftheta, s_f alone changes the coefficient too.
    const auto unbent =
        initial.model->WithTunable({FocalAtAxisPx(refined) / FocalAtAxisPx(*initial.model),
                                    refined.tunable().principal_point_px});
    if (unbent.ok()) sum += RadialCoefficient(refined) - RadialCoefficient(**unbent);
  }
  return sum / static_cast<double>(used.size());
}

/// Moves the camera to the mean. Fails only when the lens model refuses the intrinsics.
Status Apply(const CameraConfig& initial, const Estimate& mean, double radial_change,
             const CameraVector& prior_stddev, double widening, CameraConfig* camera,
             CameraStddev* stddev) {
  const CameraVector change = mean.value.cwiseProduct(prior_stddev);
  const TunableIntrinsics& before = initial.model->tunable();
  const auto model = initial.model->WithTunable(
      {before.focal_scale * (1.0 + change[6]), before.principal_point_px + change.segment<2>(7)});
  if (!model.ok()) return model.status();
  const auto bent = WithRadialChange(**model, radial_change);
  if (!bent.ok()) return bent.status();
  camera->model = *bent;
  camera->time_offset_s = initial.time_offset_s + change[9];
  camera->lidar_from_camera =
      Rigid3(initial.lidar_from_camera.rotation * ExpSo3(change.segment<3>(3)),
             initial.lidar_from_camera.translation +
                 initial.lidar_from_camera.rotation * Eigen::Vector3d(change.head<3>()));
  const CameraVector sigma = mean.covariance.diagonal().cwiseSqrt();
  stddev->correlation =
      sigma.cwiseInverse().asDiagonal() * mean.covariance * sigma.cwiseInverse().asDiagonal();
  CameraVector wide = (widening * sigma.cwiseProduct(prior_stddev)).cwiseMin(prior_stddev);
  wide = (sigma.array() > 2.0 * kHeld).select(wide, 0.0);
  stddev->translation_m = wide.head<3>();
  stddev->rotation_rad = wide.segment<3>(3);
  stddev->focal_scale = wide[6];
  stddev->principal_point_px = wide.segment<2>(7);
  stddev->time_offset_s = wide[9];
  return Status::Ok();
}

/// What was counted on all stretches, with the residuals of the first one that was accepted.
CameraQuality SumOfQualities(const std::vector<StretchCalibration>& stretches,
                             const std::vector<Estimate>& used, std::size_t camera) {
  CameraQuality sum = stretches[used.front().stretch].result.cameras[camera];
  for (std::size_t i = 1; i < used.size(); ++i) {
    const CameraQuality& quality = stretches[used[i].stretch].result.cameras[camera];
    sum.num_tracks += quality.num_tracks;
    sum.num_inlier_tracks += quality.num_inlier_tracks;
    sum.num_cross_camera_matches += quality.num_cross_camera_matches;
  }
  sum.miscalibration_rate_before.reset();
  sum.miscalibration_rate_after.reset();
  sum.reasons.clear();
  return sum;
}

void CombineCamera(const CameraConfig& initial, const PriorOptions& prior,
                   const std::vector<StretchCalibration>& stretches, std::size_t camera,
                   CameraConfig* combined, CameraQuality* quality) {
  const CameraVector prior_stddev = PriorStddev(initial, prior);
  std::vector<Estimate> estimates;
  std::vector<std::string> notes;
  for (std::size_t s = 0; s < stretches.size(); ++s) {
    const CalibrationResult& result = stretches[s].result;
    const CameraQuality& here = result.cameras[camera];
    if (here.accepted) {
      estimates.push_back(
          MakeEstimate(s, initial, result.rig.cameras[camera], here.stddev, prior_stddev));
    } else {
      notes.push_back("not accepted on " + stretches[s].name +
                      (here.reasons.empty() ? "" : ": " + here.reasons.front()));
    }
  }
  if (estimates.empty()) {
    *quality = stretches.front().result.cameras[camera];
    return;
  }
  const std::vector<Estimate> used = Agreeing(estimates, stretches, &notes);
  *quality = SumOfQualities(stretches, used.empty() ? estimates : used, camera);
  Status applied;
  if (!used.empty()) {
    const Estimate mean = Mean(used);
    applied = Apply(initial, mean, RadialChange(initial, stretches, used, camera), prior_stddev,
                    SpreadOverStated(used, mean), combined, &quality->stddev);
    if (!applied.ok()) notes.push_back(applied.message());
  }
  quality->accepted = !used.empty() && applied.ok();
  quality->reasons = notes;
}

}  // namespace

Result<CalibrationResult> CombineStretches(const Rig& initial, const PriorOptions& prior,
                                           const std::vector<StretchCalibration>& stretches) {
  if (stretches.empty()) return Status::InvalidArgument("there is no stretch to combine");
  for (const StretchCalibration& stretch : stretches) {
    if (stretch.result.cameras.size() != initial.cameras.size()) {
      return Status::InvalidArgument(stretch.name + " has another number of cameras");
    }
  }
  CalibrationResult combined;
  combined.rig = initial;
  combined.cameras.resize(initial.cameras.size());
  combined.accepted = true;
  for (std::size_t i = 0; i < initial.cameras.size(); ++i) {
    CombineCamera(initial.cameras[i], prior, stretches, i, &combined.rig.cameras[i],
                  &combined.cameras[i]);
    if (combined.cameras[i].accepted) continue;
    combined.accepted = false;
    combined.reasons.push_back(initial.cameras[i].name + " was not accepted");
  }
  return combined;
}

}  // namespace scenecalib
