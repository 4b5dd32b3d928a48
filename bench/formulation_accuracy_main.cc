// Two formulations of a track in a plane, on exact planes and trajectories: the star about the
// reference view (whose pixel is the point), each residual whitened by itself; and the point that
// moves freely within the plane (two unknowns a track, eliminated), which is the star whitened by
// the joint covariance of all residuals of the track, as they share the reference pixel's error.

#include <CLI/CLI.hpp>
#include <Eigen/Cholesky>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <vector>

#include "scenecalib/calibration/camera_calibration.h"
#include "scenecalib/calibration/transfer_error.h"
#include "testing/canyon_scene.h"

namespace scenecalib {
namespace {

constexpr double kDegrees = 180.0 / M_PI;
constexpr int kIterations = 6;
constexpr double kFloor_px = 0.03;

/// A track's plane, and its views with their noise.
struct PlaneTrack {
  Eigen::Vector3d point_in_map_m;
  Eigen::Vector3d normal_in_map;
  TransferView reference;
  std::vector<TransferView> others;
  std::vector<Eigen::Matrix2d> covariances_px2;
};

std::vector<PlaneTrack> Tie(const testing::CanyonScene& scene, std::size_t camera,
                            double reference_noise_px, Random* random) {
  const CameraConfig& truth = scene.rig.cameras[camera];
  std::vector<PlaneTrack> tied;
  for (const Track& track : scene.segments[camera].tracks) {
    const auto view_at = [&](const TrackObservation& observation) {
      TransferView view;
      view.pixel = observation.pixel;
      view.map_from_lidar = *scene.map.map_from_lidar.Interpolate(observation.stamp_ns);
      return view;
    };
    PlaneTrack plane;
    plane.reference = view_at(track.observations[static_cast<std::size_t>(track.reference)]);
    const Rigid3 map_from_camera = plane.reference.map_from_lidar * truth.lidar_from_camera;
    const auto ray = truth.model->Unproject(plane.reference.pixel);
    if (!ray || !testing::MeetCanyon(map_from_camera.translation, map_from_camera.rotation * *ray,
                                     &plane.point_in_map_m)) {
      continue;
    }
    const Eigen::Vector3d& point = plane.point_in_map_m;
    plane.normal_in_map = point.z() < -1.99            ? Eigen::Vector3d::UnitZ()
                          : std::abs(point.y()) > 8.99 ? Eigen::Vector3d::UnitY()
                                                       : Eigen::Vector3d::UnitX();
    plane.reference.pixel +=
        reference_noise_px * Eigen::Vector2d(random->Gaussian(), random->Gaussian());
    for (std::size_t k = 0; k < track.observations.size(); ++k) {
      if (static_cast<int>(k) == track.reference) continue;
      plane.others.push_back(view_at(track.observations[k]));
      plane.covariances_px2.push_back(track.observations[k].covariance_px2);
    }
    tied.push_back(std::move(plane));
  }
  return tied;
}

/// Adds a track's part of the normal equations of (rotation, translation); false when it cannot be
/// evaluated.
bool AddTrack(const PlaneTrack& track, const CameraParameters& camera, double reference_sigma_px,
              bool is_free, Eigen::Matrix<double, 6, 6>* information, Vector6d* gradient) {
  const auto n = static_cast<Eigen::Index>(2 * track.others.size());
  Eigen::MatrixXd jacobian(n, 6);
  Eigen::MatrixXd by_reference(n, 2);
  Eigen::VectorXd residual(n);
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(n, n);
  for (std::size_t k = 0; k < track.others.size(); ++k) {
    const auto row = static_cast<Eigen::Index>(2 * k);
    Eigen::Vector2d residual_px;
    TransferJacobians j;
    if (!EvaluateTransfer(track.reference, camera, Vector6d::Zero(), track.others[k], camera,
                          Vector6d::Zero(), track.point_in_map_m, track.normal_in_map, &residual_px,
                          &j)) {
      return false;
    }
    residual.segment<2>(row) = residual_px;
    jacobian.block<2, 3>(row, 0) = j.source.by_rotation + j.target.by_rotation;
    jacobian.block<2, 3>(row, 3) = j.source.by_translation + j.target.by_translation;
    by_reference.middleRows<2>(row) = reference_sigma_px * j.by_source_pixel;
    covariance.block<2, 2>(row, row) = track.covariances_px2[k];
    if (!is_free) {
      covariance.block<2, 2>(row, row) +=
          by_reference.middleRows<2>(row) * by_reference.middleRows<2>(row).transpose();
    }
  }
  if (is_free) {
    covariance += by_reference * by_reference.transpose();
    const Eigen::LLT<Eigen::MatrixXd> factor(covariance);
    *information += jacobian.transpose() * factor.solve(jacobian);
    *gradient += jacobian.transpose() * factor.solve(residual);
    return true;
  }
  for (Eigen::Index row = 0; row < n; row += 2) {
    const Eigen::Matrix2d weight = covariance.block<2, 2>(row, row).inverse();
    *information += jacobian.middleRows<2>(row).transpose() * weight * jacobian.middleRows<2>(row);
    *gradient += jacobian.middleRows<2>(row).transpose() * weight * residual.segment<2>(row);
  }
  return true;
}

struct Outcome {
  double rotation_deg = 0.0;
  double translation_mm = 0.0;
  double seconds = 0.0;
};

Outcome Solve(const std::vector<PlaneTrack>& tracks, const CameraConfig& initial,
              const CameraConfig& truth, double reference_sigma_px, bool is_free) {
  const auto start = std::chrono::steady_clock::now();
  CameraParameters camera = InitialParameters(initial);
  for (int i = 0; i < kIterations; ++i) {
    Eigen::Matrix<double, 6, 6> information = Eigen::Matrix<double, 6, 6>::Zero();
    Vector6d gradient = Vector6d::Zero();
    for (const PlaneTrack& track : tracks) {
      AddTrack(track, camera, reference_sigma_px, is_free, &information, &gradient);
    }
    const Vector6d step = -information.ldlt().solve(gradient);
    camera.rotation_delta_rad = step.head<3>();
    camera.translation_delta_m = step.tail<3>();
    camera.Rebase();
  }
  Outcome outcome;
  outcome.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  const Rigid3 error = truth.lidar_from_camera.Inverse() * camera.LidarFromCamera();
  outcome.rotation_deg = kDegrees * LogSo3(error.rotation).norm();
  outcome.translation_mm = 1e3 * error.translation.norm();
  return outcome;
}

void Compare(double reference_noise_px, double reference_sigma_px, int seeds) {
  for (const bool is_free : {false, true}) {
    double squares[2] = {};
    double seconds = 0.0;
    int count = 0;
    for (int seed = 1; seed <= seeds; ++seed) {
      testing::CanyonOptions canyon;
      canyon.seed = static_cast<std::uint64_t>(seed);
      const testing::CanyonScene scene =
          testing::MakeCanyonScene({testing::CanyonCamera("front", 0.0, 680.0, false),
                                    testing::CanyonCamera("left", 1.2, 330.0, true)},
                                   canyon);
      const Rig initial = testing::Perturb(scene.rig, 0.2 / kDegrees, 0.02, canyon.seed);
      Random random(canyon.seed);
      for (std::size_t c = 0; c < scene.rig.cameras.size(); ++c) {
        const std::vector<PlaneTrack> tracks = Tie(scene, c, reference_noise_px, &random);
        const Outcome outcome =
            Solve(tracks, initial.cameras[c], scene.rig.cameras[c], reference_sigma_px, is_free);
        squares[0] += std::pow(outcome.rotation_deg, 2);
        squares[1] += std::pow(outcome.translation_mm, 2);
        seconds += outcome.seconds;
        ++count;
      }
    }
    std::printf(
        "reference off by %.2f px, taken to be %.2f px: %s %.5f deg  %.3f mm RMS, %.1f ms\n",
        reference_noise_px, reference_sigma_px, is_free ? "free point" : "star      ",
        std::sqrt(squares[0] / count), std::sqrt(squares[1] / count), 1e3 * seconds / count);
  }
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("The star about the reference view against a point that is free in its plane.");
  int seeds = 50;
  app.add_option("--seeds", seeds, "scenes");
  CLI11_PARSE(app, argc, argv);
  scenecalib::Compare(0.0, scenecalib::kFloor_px, seeds);
  scenecalib::Compare(scenecalib::kFloor_px, scenecalib::kFloor_px, seeds);
  scenecalib::Compare(0.05, 0.05, seeds);
  return 0;
}
