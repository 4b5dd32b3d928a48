#include "scenecalib/calibration/transfer_error.h"

#include <gtest/gtest.h>

#include <functional>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

CameraModelPtr Pinhole() {
  CameraIntrinsics intrinsics;
  intrinsics.model = "plumb_bob";
  intrinsics.width_px = 960;
  intrinsics.height_px = 600;
  intrinsics.focal_px = {680.0, 682.0};
  intrinsics.principal_point_px = {480.0, 300.0};
  intrinsics.distortion = {-0.06, 0.02, 0.0004, -0.0003, 0.0};
  return CreateCameraModel(intrinsics).value();
}

CameraModelPtr Fisheye() {
  CameraIntrinsics intrinsics;
  intrinsics.model = "ftheta";
  intrinsics.width_px = 1280;
  intrinsics.height_px = 720;
  intrinsics.principal_point_px = {641.0, 352.0};
  intrinsics.polynomial_px = {190.0, 1.0, -3.0, 0.3, 0.0};
  return CreateCameraModel(intrinsics).value();
}

/// A vehicle that drives along x over the plane z = -2 with a camera that looks forward and down.
struct Scene {
  CameraModelPtr model;
  CameraParameters camera;
  TransferView source;
  TransferView target;
  Vector6d source_correction;
  Vector6d target_correction;
  Eigen::Vector3d plane_point{6.0, 0.0, -2.0};
  Eigen::Vector3d plane_normal{0.0, 0.05, 1.0};

  explicit Scene(CameraModelPtr camera_model, std::uint64_t seed) : model(std::move(camera_model)) {
    Random random(seed);
    const auto vector = [&random](double scale) {
      return Eigen::Vector3d(
          scale * Eigen::Vector3d(random.Gaussian(), random.Gaussian(), random.Gaussian()));
    };
    plane_normal.normalize();
    Eigen::Matrix3d forward;
    forward << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    camera.model = model.get();
    camera.base_lidar_from_camera =
        Rigid3(Eigen::Quaterniond(forward) * ExpSo3(Eigen::Vector3d(-0.2, 0.0, 0.0)),
               Eigen::Vector3d(0.6, 0.1, -0.4));
    camera.rotation_delta_rad = vector(0.02);
    camera.translation_delta_m = vector(0.05);
    camera.intrinsics << 1.01, model->tunable().principal_point_px + Eigen::Vector2d(3.0, -2.0);
    source_correction << vector(0.005), vector(0.01);
    target_correction << vector(0.005), vector(0.01);
    source.map_from_lidar = Rigid3(ExpSo3(vector(0.02)), vector(0.1));
    target.map_from_lidar =
        Rigid3(ExpSo3(vector(0.02)), Eigen::Vector3d(1.5, 0.0, 0.0) + vector(0.1));
    source.twist_in_lidar << vector(0.1), Eigen::Vector3d(8.0, 0.0, 0.0);
    target.twist_in_lidar << vector(0.1), Eigen::Vector3d(8.0, 0.0, 0.0);
    // Both views see one point of the plane.
    const Eigen::Vector3d across = plane_normal.cross(Eigen::Vector3d::UnitX()).normalized();
    const Eigen::Vector3d x = plane_point + 1.5 * across;
    source.pixel = See(source, source_correction, x);
    target.pixel = See(target, target_correction, x);
  }

  Eigen::Vector2d See(const TransferView& view, const Vector6d& correction,
                      const Eigen::Vector3d& x) const {
    const Rigid3 map_from_camera = view.map_from_lidar *
                                   Rigid3(ExpSo3(correction.head<3>()), correction.tail<3>()) *
                                   camera.LidarFromCamera();
    return *model->ProjectTuned(map_from_camera.Inverse() * x, camera.Intrinsics(), nullptr);
  }

  bool Evaluate(Eigen::Vector2d* residual, TransferJacobians* jacobians) const {
    return EvaluateTransfer(source, camera, source_correction, target, camera, target_correction,
                            plane_point, plane_normal, residual, jacobians);
  }

  Eigen::Vector2d Residual() const {
    Eigen::Vector2d residual(1e9, 1e9);
    EXPECT_TRUE(Evaluate(&residual, nullptr));
    return residual;
  }
};

/// Central difference of the residual by one scalar of the scene.
Eigen::Vector2d Numeric(Scene scene, const std::function<double*(Scene*)>& scalar, double step) {
  double* value = scalar(&scene);
  const double original = *value;
  *value = original + step;
  const Eigen::Vector2d plus = scene.Residual();
  *value = original - step;
  const Eigen::Vector2d minus = scene.Residual();
  return (plus - minus) / (2.0 * step);
}

class TransferErrorOfModel : public ::testing::TestWithParam<bool> {
 protected:
  Scene MakeScene(std::uint64_t seed) const {
    return Scene(GetParam() ? Fisheye() : Pinhole(), seed);
  }
};

TEST_P(TransferErrorOfModel, IsZeroAtTheTruth) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    EXPECT_LT(MakeScene(seed).Residual().norm(), 1e-6);
  }
}

TEST_P(TransferErrorOfModel, JacobiansAgreeWithFiniteDifferences) {
  constexpr double kStep = 1e-6;
  constexpr double kRelative = 1e-5;  // of the largest derivative, some hundred pixels per unit
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const Scene scene = MakeScene(seed);
    Eigen::Vector2d residual;
    TransferJacobians j;
    ASSERT_TRUE(scene.Evaluate(&residual, &j));
    const auto expect = [&](const Eigen::Vector2d& analytic,
                            const std::function<double*(Scene*)>& scalar, double step) {
      const Eigen::Vector2d numeric = Numeric(scene, scalar, step);
      EXPECT_LT((analytic - numeric).norm(), kRelative * (100.0 + numeric.norm()));
    };
    for (int k = 0; k < 3; ++k) {
      expect(
          j.source.by_rotation.col(k) + j.target.by_rotation.col(k),
          [k](Scene* s) { return &s->camera.rotation_delta_rad[k]; }, kStep);
      expect(
          j.source.by_translation.col(k) + j.target.by_translation.col(k),
          [k](Scene* s) { return &s->camera.translation_delta_m[k]; }, kStep);
      expect(
          j.source.by_intrinsics.col(k) + j.target.by_intrinsics.col(k),
          [k](Scene* s) { return &s->camera.intrinsics[k]; }, kStep);
    }
    for (int k = 0; k < 6; ++k) {
      expect(
          j.source.by_correction.col(k), [k](Scene* s) { return &s->source_correction[k]; }, kStep);
      expect(
          j.target.by_correction.col(k), [k](Scene* s) { return &s->target_correction[k]; }, kStep);
    }
    for (int k = 0; k < 2; ++k) {
      expect(
          j.by_source_pixel.col(k), [k](Scene* s) { return &s->source.pixel[k]; }, 1e-4);
    }
    expect(
        j.source.by_correction * scene.source.twist_in_lidar +
            j.target.by_correction * scene.target.twist_in_lidar,
        [](Scene* s) { return &s->camera.time_offset_delta_s; }, kStep);
  }
}

TEST_P(TransferErrorOfModel, DerivativeByPlaneOffsetIsThatOfAShiftAlongTheNormal) {
  const Scene scene = MakeScene(3);
  Eigen::Vector2d residual;
  TransferJacobians j;
  ASSERT_TRUE(scene.Evaluate(&residual, &j));
  constexpr double kStep = 1e-5;
  Scene moved = scene;
  moved.plane_point += kStep * moved.plane_normal;
  EXPECT_LT(((moved.Residual() - residual) / kStep - j.by_plane_offset).norm(),
            1e-2 * (1.0 + j.by_plane_offset.norm()));
}

INSTANTIATE_TEST_SUITE_P(PinholeAndFisheye, TransferErrorOfModel, ::testing::Bool());

TEST(TransferError, MatchesAHandComputedTransfer) {
  // A pinhole without distortion, 2 m above the ground, looking straight down; it moves 1 m along x
  // of the image. A ground point under the first view is seen f * 1 / 2 to the left in the second.
  CameraIntrinsics intrinsics;
  intrinsics.model = "plumb_bob";
  intrinsics.width_px = 1000;
  intrinsics.height_px = 1000;
  intrinsics.focal_px = {400.0, 400.0};
  intrinsics.principal_point_px = {500.0, 500.0};
  intrinsics.distortion = {0.0, 0.0, 0.0, 0.0, 0.0};
  const CameraModelPtr model = CreateCameraModel(intrinsics).value();
  CameraParameters camera;
  camera.model = model.get();
  camera.intrinsics << 1.0, 500.0, 500.0;
  Eigen::Matrix3d down;
  down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  camera.base_lidar_from_camera = Rigid3(Eigen::Quaterniond(down), Eigen::Vector3d::Zero());
  TransferView source;
  source.pixel = {500.0, 500.0};
  TransferView target;
  target.map_from_lidar.translation.x() = 1.0;
  target.pixel = {301.0, 498.0};
  Eigen::Vector2d residual;
  ASSERT_TRUE(EvaluateTransfer(source, camera, Vector6d::Zero(), target, camera, Vector6d::Zero(),
                               {7.0, 7.0, -2.0}, Eigen::Vector3d::UnitZ(), &residual, nullptr));
  EXPECT_NEAR(residual.x(), 300.0 - 301.0, 1e-9);
  EXPECT_NEAR(residual.y(), 500.0 - 498.0, 1e-9);
}

TEST(TransferError, FailsInsteadOfVanishingWhenTheRayMissesThePlane) {
  Scene scene(Pinhole(), 1);
  Eigen::Vector2d residual(7.0, 7.0);
  scene.plane_point = Eigen::Vector3d(0.0, 0.0, 50.0);  // above: the ray goes down
  EXPECT_FALSE(scene.Evaluate(&residual, nullptr));
  EXPECT_EQ(residual.x(), 7.0);
}

TEST(TransferError, FailsWhenThePointLiesBehindTheTargetCamera) {
  Scene scene(Pinhole(), 1);
  scene.target.map_from_lidar.translation.x() = 40.0;
  Eigen::Vector2d residual;
  EXPECT_FALSE(scene.Evaluate(&residual, nullptr));
}

}  // namespace
}  // namespace scenecalib
