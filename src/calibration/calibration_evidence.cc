#include "scenecalib/calibration/calibration_evidence.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <utility>

namespace scenecalib {
namespace {

constexpr std::size_t kMaxResidualsPerCamera = 4000;

/// Residual of a term at given parameters; none where it cannot be evaluated.
std::optional<Eigen::Vector2d> Residual(const TransferTerm& term,
                                        const std::vector<CameraParameters>& cameras,
                                        const TrajectoryCorrection& correction) {
  Eigen::Vector2d residual_px;
  if (!EvaluateTransfer(term.source, cameras[static_cast<std::size_t>(term.source_camera)],
                        correction.At(term.source_place), term.target,
                        cameras[static_cast<std::size_t>(term.target_camera)],
                        correction.At(term.target_place), term.plane_point_in_map_m,
                        term.plane_normal_in_map, &residual_px, nullptr)) {
    return std::nullopt;
  }
  return residual_px;
}

double Median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

std::vector<ResidualSample> SampleResiduals(const JointCalibration& joint, int joint_camera) {
  std::vector<const TransferTerm*> terms;
  for (const TransferTerm& term : joint.terms) {
    if (term.target_camera == joint_camera) terms.push_back(&term);
  }
  const CameraParameters& camera = joint.cameras[static_cast<std::size_t>(joint_camera)];
  const Eigen::Vector3d lidar_from_camera_m = camera.LidarFromCamera().translation;
  std::vector<ResidualSample> samples;
  const std::size_t count = std::min(terms.size(), kMaxResidualsPerCamera);
  for (std::size_t i = 0; i < count; ++i) {
    const TransferTerm& term = *terms[i * terms.size() / count];
    const auto residual_px = Residual(term, joint.cameras, joint.correction);
    if (!residual_px) continue;
    ResidualSample sample;
    sample.pixel = term.target.pixel;
    sample.residual_px = *residual_px;
    sample.range_m =
        (term.plane_point_in_map_m - term.target.map_from_lidar * lidar_from_camera_m).norm();
    sample.surface = term.surface;
    samples.push_back(sample);
  }
  return samples;
}

void AddCrossCameraEvidence(const Rig& initial, const JointCalibration& joint,
                            const std::vector<int>& camera_of_joint,
                            CalibrationEvidence* evidence) {
  evidence->joint_converged = joint.converged;
  evidence->cross_camera = joint.cross_camera;
  evidence->cross_camera.matches.clear();
  for (const CrossCameraMatch& match : joint.cross_camera.matches) {
    const auto source = static_cast<std::size_t>(match.source_camera);
    const Track& track = joint.tracks[source][static_cast<std::size_t>(match.source_point)];
    const TrackObservation& reference =
        track.observations[static_cast<std::size_t>(track.reference)];
    evidence->matches.push_back(
        {camera_of_joint[source], camera_of_joint[static_cast<std::size_t>(match.target_camera)],
         reference.stamp_ns, match.target_stamp_ns, reference.pixel, match.pixel});
  }
  std::vector<CameraParameters> initial_cameras;
  for (const int camera : camera_of_joint) {
    initial_cameras.push_back(InitialParameters(initial.cameras[static_cast<std::size_t>(camera)]));
  }
  struct Distances {
    std::vector<double> before_px;
    std::vector<double> after_px;
  };
  std::map<std::pair<int, int>, Distances> by_pair;
  for (const TransferTerm& term : joint.cross_terms) {
    const auto after = Residual(term, joint.cameras, joint.correction);
    if (!after) continue;
    // A start so far off that the point leaves the view is as bad as can be, not left out.
    const auto before = Residual(term, initial_cameras, TrajectoryCorrection());
    Distances& distances = by_pair[{term.source_camera, term.target_camera}];
    distances.after_px.push_back(after->norm());
    distances.before_px.push_back(before ? before->norm()
                                         : std::numeric_limits<double>::infinity());
  }
  for (const auto& [pair, distances] : by_pair) {
    evidence->pairs.push_back({camera_of_joint[static_cast<std::size_t>(pair.first)],
                               camera_of_joint[static_cast<std::size_t>(pair.second)],
                               static_cast<int>(distances.after_px.size()),
                               Median(distances.before_px), Median(distances.after_px)});
  }
  double sum_m2 = 0.0;
  double sum_rad2 = 0.0;
  for (const Vector6d& knot : joint.correction.knots()) {
    sum_rad2 += knot.head<3>().squaredNorm();
    sum_m2 += knot.tail<3>().squaredNorm();
  }
  if (joint.correction.empty()) return;
  const auto num_knots = static_cast<double>(joint.correction.knots().size());
  evidence->correction_rms_rad = std::sqrt(sum_rad2 / num_knots);
  evidence->correction_rms_m = std::sqrt(sum_m2 / num_knots);
}

}  // namespace scenecalib
