// One joint solve of twelve cameras, extrinsics, intrinsics and trajectory correction, to
// convergence: correspondences of a drive between planes, three in ten between two cameras.

#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include <Eigen/Geometry>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/calibration/calibration_problem.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

constexpr int kNumCameras = 12;
constexpr double kDuration_s = 20.0;
constexpr double kSpeed_m_s = 8.0;
constexpr double kImageRate_hz = 10.0;
constexpr double kCrossCameraShare = 0.3;
constexpr double kPixelNoise_px = 0.1;
constexpr int kWidth_px = 960;
constexpr int kHeight_px = 600;
constexpr double kBorder_px = 20.0;

CameraModelPtr WideCamera() {
  CameraIntrinsics intrinsics;
  intrinsics.model = "ftheta";
  intrinsics.width_px = kWidth_px;
  intrinsics.height_px = kHeight_px;
  intrinsics.principal_point_px = {478.0, 302.0};
  intrinsics.polynomial_px = {460.0, -1.5, -6.0, 1.1, 0.3};
  return CreateCameraModel(intrinsics).value();
}

Rigid3 MapFromLidar(double time_s) {
  const double yaw_rad = 0.4 * std::sin(0.5 * time_s);
  return {Eigen::Quaterniond(Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ())),
          {kSpeed_m_s * time_s, 3.0 * std::sin(0.3 * time_s), 2.0}};
}

/// The rig all around, its true parameters, and the terms between its views.
class Scene {
 public:
  explicit Scene(int num_terms)
      : model_(WideCamera()), correction_(0, AddSeconds(0, kDuration_s), 0.1) {
    Eigen::Matrix3d forward;
    forward << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    for (int c = 0; c < kNumCameras; ++c) {
      CameraParameters camera;
      camera.model = model_.get();
      const double yaw_rad = 2.0 * M_PI * c / kNumCameras;
      camera.base_lidar_from_camera = Rigid3(
          ExpSo3({0.0, 0.0, yaw_rad}) * Eigen::Quaterniond(forward) * ExpSo3({-0.15, 0.0, 0.0}),
          {std::cos(yaw_rad), std::sin(yaw_rad), -0.3});
      camera.intrinsics << 1.0, model_->tunable().principal_point_px;
      cameras_.push_back(camera);
    }
    Random random(5);
    terms_.reserve(num_terms);
    while (static_cast<int>(terms_.size()) < num_terms) {
      const auto term = DrawTerm(&random);
      if (term) terms_.push_back(*term);
    }
  }

  /// A problem that starts off the truth, with the scene's terms; to be asked for once.
  CalibrationProblem Problem(std::vector<CameraParameters>* cameras,
                             TrajectoryCorrection* correction) {
    *cameras = cameras_;
    *correction = correction_;
    Random random(6);
    CalibrationProblem problem;
    problem.cameras = cameras;
    problem.correction = correction;
    for (CameraParameters& camera : *cameras) {
      CameraPrior prior;
      for (int k = 0; k < 3; ++k) {
        camera.rotation_delta_rad[k] = random.Uniform(-0.004, 0.004);
        camera.translation_delta_m[k] = random.Uniform(-0.03, 0.03);
      }
      camera.Rebase();
      prior.initial_lidar_from_camera = camera.base_lidar_from_camera;
      camera.intrinsics += Eigen::Vector3d(0.003, 2.0, -2.0);
      prior.initial_intrinsics = camera.intrinsics;
      problem.priors.push_back(prior);
    }
    problem.time_offset_s.assign(kNumCameras, 0.0);
    problem.free.intrinsics = true;
    problem.free.correction = true;
    problem.terms = std::move(terms_);
    return problem;
  }

  double WorstRotation_rad(const std::vector<CameraParameters>& cameras) const {
    double worst = 0.0;
    for (std::size_t c = 0; c < cameras.size(); ++c) {
      worst = std::max(worst, RotationAngle(cameras_[c].base_lidar_from_camera.rotation,
                                            cameras[c].LidarFromCamera().rotation));
    }
    return worst;
  }

 private:
  TransferView ViewAt(double time_s) const {
    TransferView view;
    view.map_from_lidar = MapFromLidar(time_s);
    return view;
  }

  /// The next image of a camera; cameras are not synchronised.
  static double ImageTime_s(int camera, double time_s) {
    const double phase = static_cast<double>(camera) / kNumCameras;
    return (std::ceil(time_s * kImageRate_hz - phase) + phase) / kImageRate_hz;
  }

  /// A pixel on the ground or a wall, seen again up to a second later.
  std::optional<TransferTerm> DrawTerm(Random* random) const {
    TransferTerm term;
    const bool crosses = random->Uniform() < kCrossCameraShare;
    term.source_camera = static_cast<int>(random->Uniform(0.0, kNumCameras));
    term.target_camera =
        crosses
            ? (term.source_camera + (random->Uniform() < 0.5 ? 1 : kNumCameras - 1)) % kNumCameras
            : term.source_camera;
    const double source_s =
        ImageTime_s(term.source_camera, random->Uniform(0.0, kDuration_s - 1.1));
    const double target_s = ImageTime_s(term.target_camera, source_s + random->Uniform(0.1, 1.0));
    if (!crosses && source_s == target_s) return std::nullopt;
    term.source = ViewAt(source_s);
    term.target = ViewAt(target_s);
    term.source.pixel = {random->Uniform(kBorder_px, kWidth_px - kBorder_px),
                         random->Uniform(kBorder_px, kHeight_px - kBorder_px)};
    term.source_place = correction_.Locate(AddSeconds(0, source_s));
    term.target_place = correction_.Locate(AddSeconds(0, target_s));
    term.target_stamp_ns = AddSeconds(0, target_s);
    const auto ray = model_->Unproject(term.source.pixel);
    if (!ray) return std::nullopt;
    const CameraParameters& source = cameras_[term.source_camera];
    const Rigid3 map_from_camera = term.source.map_from_lidar * source.LidarFromCamera();
    const Eigen::Vector3d direction = map_from_camera.rotation * *ray;
    if (direction.z() < -0.1) {
      term.plane_normal_in_map = Eigen::Vector3d::UnitZ();
      term.plane_point_in_map_m.setZero();
    } else if (std::abs(direction.y()) > 0.2) {
      term.plane_normal_in_map = {0.0, direction.y() > 0.0 ? -1.0 : 1.0, 0.0};
      term.plane_point_in_map_m = {0.0, direction.y() > 0.0 ? 15.0 : -15.0, 0.0};
    } else {
      return std::nullopt;
    }
    Eigen::Vector2d residual;
    const Vector6d none = Vector6d::Zero();
    if (!EvaluateTransfer(term.source, source, none, term.target, cameras_[term.target_camera],
                          none, term.plane_point_in_map_m, term.plane_normal_in_map, &residual,
                          nullptr)) {
      return std::nullopt;
    }
    // The target pixel was (0, 0): the residual is where the point is seen.
    if (residual.x() < kBorder_px || residual.y() < kBorder_px ||
        residual.x() > kWidth_px - kBorder_px || residual.y() > kHeight_px - kBorder_px) {
      return std::nullopt;
    }
    term.target.pixel =
        residual + kPixelNoise_px * Eigen::Vector2d(random->Gaussian(), random->Gaussian());
    term.whitening = Eigen::Matrix2d::Identity() / kPixelNoise_px;
    return term;
  }

  CameraModelPtr model_;
  TrajectoryCorrection correction_;
  std::vector<CameraParameters> cameras_;
  std::vector<TransferTerm> terms_;
};

double PeakMebibytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;
}

void SolveTwelveCameras(benchmark::State& state) {
  std::optional<Scene> scene(std::in_place, static_cast<int>(state.range(0)));
  std::vector<CameraParameters> cameras;
  TrajectoryCorrection correction;
  CalibrationProblem problem = scene->Problem(&cameras, &correction);
  const std::vector<CameraParameters> start = cameras;
  const TrajectoryCorrection zero = correction;
  int iterations = 0;
  for (auto _ : state) {
    cameras = start;
    correction = zero;
    const auto evidence = problem.Solve();
    if (!evidence.ok()) {
      state.SkipWithError(evidence.status().message().c_str());
      break;
    }
    if (!evidence->converged) state.SkipWithError("did not converge");
    iterations = evidence->iterations;
  }
  state.counters["iterations"] = iterations;
  state.counters["worst_mdeg"] = 1e3 * 180.0 / M_PI * scene->WorstRotation_rad(cameras);
  state.counters["peak_MiB"] = PeakMebibytes();
}
BENCHMARK(SolveTwelveCameras)
    ->Arg(500000)
    ->Arg(2000000)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime()
    ->MeasureProcessCPUTime();

}  // namespace
}  // namespace scenecalib
