#include "scenecalib/sensor/camera_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <string>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/sensor/camera_factory.h"
#include "scenecalib/sensor/lens_shape.h"

namespace scenecalib {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kRoundTripPx = 1e-6;  // promised over the whole image
// Central differences with a step of 1e-6 are good to about 1e-9 of the function's scale.
constexpr double kStep = 1e-6;
constexpr double kJacobianTolerance = 2e-6;  // relative to the largest element

CameraIntrinsics Ftheta120() {
  return {"ftheta", 960, 604, {}, {478.3, 305.1}, {459.2, -1.7, -6.2, 1.3, 0.31}, {}};
}

/// 200 degrees between left and right, 226 between opposite corners.
CameraIntrinsics Ftheta200() {
  return {"ftheta", 1280, 720, {}, {640.4, 356.9}, {386.0, 2.1, -8.3, 1.2, 0.0}, {}};
}

CameraIntrinsics PlumbBob() {
  return {"plumb_bob",
          960,
          604,
          {681.0, 683.5},
          {483.2, 299.7},
          {},
          {-0.31, 0.11, 8e-4, -5e-4, -0.012}};
}

CameraIntrinsics RationalPolynomial() {
  return {"rational_polynomial",
          1280,
          720,
          {560.0, 561.3},
          {645.1, 351.8},
          {},
          {0.62, 0.12, 3e-4, -2e-4, 0.004, 0.78, 0.15, 0.004}};
}

CameraIntrinsics Equidistant190() {
  return {
      "equidistant", 1280, 960, {382.0, 383.5}, {636.2, 481.9}, {}, {0.011, -0.006, 0.0012, -1e-4}};
}

std::vector<CameraIntrinsics> AllModels() {
  return {Ftheta120(), Ftheta200(), PlumbBob(), RationalPolynomial(), Equidistant190()};
}

CameraModelPtr Create(const CameraIntrinsics& intrinsics) {
  const auto model = CreateCameraModel(intrinsics);
  EXPECT_TRUE(model.ok()) << model.status().message();
  return model.ok() ? *model : nullptr;
}

std::string Refusal(const CameraIntrinsics& intrinsics) {
  const auto model = CreateCameraModel(intrinsics);
  return model.ok() ? "accepted" : model.status().message();
}

/// Pixels over the whole image including its outermost corners.
std::vector<Eigen::Vector2d> PixelGrid(const CameraModel& camera, int steps) {
  std::vector<Eigen::Vector2d> pixels;
  for (int i = 0; i <= steps; ++i) {
    for (int j = 0; j <= steps; ++j) {
      pixels.emplace_back(-0.5 + camera.width_px() * i / static_cast<double>(steps),
                          -0.5 + camera.height_px() * j / static_cast<double>(steps));
    }
  }
  return pixels;
}

template <typename Matrix>
void ExpectSame(const Matrix& analytic, const Matrix& numeric, const std::string& what) {
  const double scale = std::max(1.0, numeric.cwiseAbs().maxCoeff());
  EXPECT_LT((analytic - numeric).cwiseAbs().maxCoeff(), kJacobianTolerance * scale)
      << what << "\nanalytic\n"
      << analytic << "\nnumeric\n"
      << numeric;
}

TEST(CameraModel, RoundTripReturnsThePixelOverTheWholeImage) {
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const CameraModelPtr camera = Create(intrinsics);
    ASSERT_NE(camera, nullptr);
    for (const Eigen::Vector2d& pixel : PixelGrid(*camera, 60)) {
      const auto ray = camera->Unproject(pixel);
      ASSERT_TRUE(ray.has_value()) << intrinsics.model << " at " << pixel.transpose();
      EXPECT_NEAR(ray->norm(), 1.0, 1e-12);
      const auto back = camera->ProjectTuned(2.5 * *ray, camera->tunable(), nullptr);
      ASSERT_TRUE(back.has_value()) << intrinsics.model << " at " << pixel.transpose();
      EXPECT_LT((*back - pixel).norm(), kRoundTripPx) << intrinsics.model;
    }
  }
}

TEST(CameraModel, RoundTripHoldsForTunedIntrinsics) {
  Random random(1);
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const CameraModelPtr camera = Create(intrinsics);
    for (int i = 0; i < 200; ++i) {
      TunableIntrinsics tuned = camera->tunable();
      tuned.focal_scale = random.Uniform(0.97, 1.03);
      tuned.principal_point_px += Eigen::Vector2d(random.Uniform(-9, 9), random.Uniform(-9, 9));
      const Eigen::Vector2d pixel(random.Uniform(0.1, 0.9) * camera->width_px(),
                                  random.Uniform(0.1, 0.9) * camera->height_px());
      const auto ray = camera->UnprojectTuned(pixel, tuned, nullptr);
      ASSERT_TRUE(ray.has_value());
      EXPECT_LT((*camera->ProjectTuned(*ray, tuned, nullptr) - pixel).norm(), kRoundTripPx);
    }
  }
}

TEST(CameraModel, ProjectionJacobiansAgreeWithFiniteDifferences) {
  Random random(2);
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const CameraModelPtr camera = Create(intrinsics);
    TunableIntrinsics tuned = camera->tunable();
    tuned.focal_scale = 1.01;
    tuned.principal_point_px += Eigen::Vector2d(3.0, -2.0);
    for (const Eigen::Vector2d& pixel : PixelGrid(*camera, 8)) {
      const auto ray = camera->UnprojectTuned(pixel, tuned, nullptr);
      if (!ray) continue;  // s_f moved the corner out of the domain
      const Eigen::Vector3d point = random.Uniform(1.0, 3.0) * *ray;
      ProjectionJacobians jacobians;
      const auto image = camera->ProjectTuned(point, tuned, &jacobians);
      ASSERT_TRUE(image.has_value());
      Eigen::Matrix<double, 2, 3> by_point, by_intrinsics;
      for (int axis = 0; axis < 3; ++axis) {
        const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(axis);
        by_point.col(axis) = (*camera->ProjectTuned(point + step, tuned, nullptr) -
                              *camera->ProjectTuned(point - step, tuned, nullptr)) /
                             (2.0 * kStep);
        const auto shifted = [&](double sign) {
          TunableIntrinsics t = tuned;
          t.focal_scale += sign * step[0];
          t.principal_point_px += sign * step.tail<2>();
          return *camera->ProjectTuned(point, t, nullptr);
        };
        by_intrinsics.col(axis) = (shifted(1.0) - shifted(-1.0)) / (2.0 * kStep);
      }
      ExpectSame(jacobians.pixel_by_point, by_point, intrinsics.model + " by point");
      ExpectSame(jacobians.pixel_by_intrinsics, by_intrinsics, intrinsics.model + " by intrinsics");
    }
  }
}

TEST(CameraModel, UnprojectionJacobiansAgreeWithFiniteDifferences) {
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const CameraModelPtr camera = Create(intrinsics);
    TunableIntrinsics tuned = camera->tunable();
    tuned.focal_scale = 0.99;
    tuned.principal_point_px += Eigen::Vector2d(-3.0, 2.0);
    for (const Eigen::Vector2d& pixel : PixelGrid(*camera, 8)) {
      constexpr double kPixelStep = 1e-3;  // rays change by about 1e-3 per px
      UnprojectionJacobians jacobians;
      if (!camera->UnprojectTuned(pixel, tuned, &jacobians)) continue;
      Eigen::Matrix<double, 3, 2> by_pixel;
      Eigen::Matrix3d by_intrinsics;
      bool inside = true;
      const auto difference = [&](const Eigen::Vector2d& dpixel, const Eigen::Vector3d& dtuned,
                                  double step) -> Eigen::Vector3d {
        TunableIntrinsics plus = tuned, minus = tuned;
        plus.focal_scale += dtuned[0];
        minus.focal_scale -= dtuned[0];
        plus.principal_point_px += dtuned.tail<2>();
        minus.principal_point_px -= dtuned.tail<2>();
        const auto after = camera->UnprojectTuned(pixel + dpixel, plus, nullptr);
        const auto before = camera->UnprojectTuned(pixel - dpixel, minus, nullptr);
        inside = inside && after && before;
        return inside ? ((*after - *before) / (2.0 * step)).eval() : Eigen::Vector3d::Zero().eval();
      };
      for (int axis = 0; axis < 3; ++axis) {
        const double step = axis == 0 ? kStep : kPixelStep;
        by_intrinsics.col(axis) =
            difference(Eigen::Vector2d::Zero(), step * Eigen::Vector3d::Unit(axis), step);
        if (axis == 2) break;
        by_pixel.col(axis) = difference(kPixelStep * Eigen::Vector2d::Unit(axis),
                                        Eigen::Vector3d::Zero(), kPixelStep);
      }
      if (!inside) continue;
      ExpectSame(jacobians.ray_by_pixel, by_pixel, intrinsics.model + " by pixel");
      ExpectSame(jacobians.ray_by_intrinsics, by_intrinsics, intrinsics.model + " by intrinsics");
    }
  }
}

TEST(CameraModel, JacobiansAreFiniteAndContinuousOnTheOpticalAxis) {
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const CameraModelPtr camera = Create(intrinsics);
    ProjectionJacobians on_axis, beside;
    const auto center = camera->Project({0.0, 0.0, 4.0}, &on_axis);
    ASSERT_TRUE(center.has_value());
    EXPECT_LT((*center - intrinsics.principal_point_px).norm(), 1e-9);
    ASSERT_TRUE(camera->Project({1e-8, -2e-8, 4.0}, &beside).has_value());
    EXPECT_LT((on_axis.pixel_by_point - beside.pixel_by_point).norm(), 1e-4) << intrinsics.model;
    UnprojectionJacobians ray_on_axis, ray_beside;
    const auto forward = camera->Unproject(intrinsics.principal_point_px, &ray_on_axis);
    ASSERT_TRUE(forward.has_value());
    EXPECT_LT((*forward - Eigen::Vector3d::UnitZ()).norm(), 1e-12);
    const Eigen::Vector2d close = intrinsics.principal_point_px + Eigen::Vector2d(1e-7, 2e-7);
    ASSERT_TRUE(camera->Unproject(close, &ray_beside).has_value());
    EXPECT_LT((ray_on_axis.ray_by_pixel - ray_beside.ray_by_pixel).norm(), 1e-8);
  }
}

TEST(CameraModel, FoldingTheTunedIntrinsicsInGivesTheSameCamera) {
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const CameraModelPtr camera = Create(intrinsics);
    TunableIntrinsics tuned = camera->tunable();
    tuned.focal_scale = 1.004;
    tuned.principal_point_px += Eigen::Vector2d(1.5, -2.5);
    const auto folded = camera->WithTunable(tuned);
    ASSERT_TRUE(folded.ok()) << folded.status().message();
    EXPECT_EQ((*folded)->tunable().focal_scale, 1.0);
    EXPECT_EQ((*folded)->tunable().principal_point_px, tuned.principal_point_px);
    for (const Eigen::Vector2d& pixel : PixelGrid(*camera, 7)) {
      const auto ray = camera->Unproject(pixel);
      const auto expected = camera->ProjectTuned(*ray, tuned, nullptr);
      ASSERT_TRUE(expected.has_value());
      EXPECT_LT((*(*folded)->ProjectTuned(*ray, (*folded)->tunable(), nullptr) - *expected).norm(),
                1e-9);
    }
  }
}

TEST(CameraModel, IntrinsicsAreGivenBackAsTheyCame) {
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const CameraModelPtr camera = Create(intrinsics);
    const CameraIntrinsics back = camera->intrinsics();
    EXPECT_EQ(camera->name(), intrinsics.model);
    EXPECT_EQ(back.model, intrinsics.model);
    EXPECT_EQ(back.width_px, intrinsics.width_px);
    EXPECT_EQ(back.height_px, intrinsics.height_px);
    EXPECT_EQ(back.focal_px, intrinsics.focal_px);
    EXPECT_EQ(back.principal_point_px, intrinsics.principal_point_px);
    EXPECT_EQ(back.polynomial_px, intrinsics.polynomial_px);
    EXPECT_EQ(back.distortion, intrinsics.distortion);
  }
}

TEST(CameraModel, ProjectGivesNothingOutsideTheImage) {
  const CameraModelPtr camera = Create(PlumbBob());
  const auto outside = camera->ProjectTuned({1.0, 0.0, 1.15}, camera->tunable(), nullptr);
  ASSERT_TRUE(outside.has_value());
  EXPECT_GT(outside->x(), 959.5);
  EXPECT_FALSE(camera->Project({1.0, 0.0, 1.15}).has_value());
  EXPECT_TRUE(camera->IsInImage({-0.5, 603.49}));
  EXPECT_FALSE(camera->IsInImage({959.5, 0.0}));
}

TEST(CameraModel, PointsWithoutADirectionOrAgainstTheAxisProjectNowhere) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const CameraModelPtr camera = Create(intrinsics);
    EXPECT_FALSE(camera->Project({0.0, 0.0, 0.0}).has_value());
    EXPECT_FALSE(camera->Project({0.0, 0.0, -1.0}).has_value());
    EXPECT_FALSE(camera->Project({nan, 0.0, 1.0}).has_value());
    EXPECT_FALSE(camera->Unproject({nan, 0.0}).has_value());
    TunableIntrinsics negative = camera->tunable();
    negative.focal_scale = -1.0;
    EXPECT_FALSE(camera->ProjectTuned({0.1, 0.0, 1.0}, negative, nullptr).has_value());
    EXPECT_FALSE(camera->UnprojectTuned({300.0, 200.0}, negative, nullptr).has_value());
  }
}

TEST(FthetaCamera, AgreesWithEquation10ByHand) {
  const CameraModelPtr camera = Create(Ftheta120());
  const double theta = 0.7;
  const double f = 459.2 * theta - 1.7 * std::pow(theta, 2) - 6.2 * std::pow(theta, 3) +
                   1.3 * std::pow(theta, 4) + 0.31 * std::pow(theta, 5);
  const Eigen::Vector2d d(0.6, -0.8);
  const Eigen::Vector3d point(3.0 * std::sin(theta) * d.x(), 3.0 * std::sin(theta) * d.y(),
                              3.0 * std::cos(theta));
  const auto pixel = camera->Project(point);
  ASSERT_TRUE(pixel.has_value());
  EXPECT_LT((*pixel - (f * d + Eigen::Vector2d(478.3, 305.1))).norm(), 1e-9);
}

TEST(FisheyeCameras, SeeBehindTheImagePlane) {
  for (const CameraIntrinsics& intrinsics : {Ftheta200(), Equidistant190()}) {
    const CameraModelPtr camera = Create(intrinsics);
    for (const double degrees : {89.999, 90.0, 90.001, 94.0}) {
      const double theta = degrees * kPi / 180.0;
      const Eigen::Vector3d ray(-std::sin(theta), 0.0, std::cos(theta));
      const auto pixel = camera->Project(ray);
      ASSERT_TRUE(pixel.has_value()) << intrinsics.model << " at " << degrees;
      EXPECT_LT(pixel->x(), intrinsics.principal_point_px.x() - 250.0);
      EXPECT_LT((*camera->Unproject(*pixel) - ray).norm(), 1e-12);
    }
    EXPECT_GT(camera->max_theta_rad(), kPi / 2.0);
  }
}

TEST(FthetaCamera, CornersThatNoRayReachesAreNoFault) {
  CameraIntrinsics intrinsics = Ftheta200();
  intrinsics.polynomial_px = {180.0, 0.0, 0.0, 0.0, 0.0};  // pi at 565 px, the corner at 737 px
  const CameraModelPtr camera = Create(intrinsics);
  ASSERT_NE(camera, nullptr);
  EXPECT_DOUBLE_EQ(camera->max_theta_rad(), kPi);
  EXPECT_FALSE(camera->Unproject({0.0, 0.0}).has_value());
  EXPECT_TRUE(camera->Unproject({90.0, 357.0}).has_value());
}

TEST(CameraModel, LargestAngleIsThatOfTheFarthestCorner) {
  const CameraModelPtr camera = Create(Ftheta120());
  const auto corner = camera->Unproject({959.5, -0.5});  // the principal point is left and low
  EXPECT_NEAR(camera->max_theta_rad(), std::acos(corner->z()), 1e-9);
}

TEST(FthetaCamera, RefusesAPolynomialThatFoldsInsideTheImage) {
  CameraIntrinsics intrinsics = Ftheta120();
  intrinsics.polynomial_px = {450.0, 0.0, -150.0, 0.0, 0.0};  // f' = 0 at theta = 1, f = 300 px
  const std::string message = Refusal(intrinsics);
  EXPECT_NE(message.find("ftheta: polynomial_px stops being monotonic at 57.29"), std::string::npos)
      << message;
  EXPECT_NE(message.find("300 px from the principal point"), std::string::npos) << message;
}

TEST(FthetaCamera, FoldsOutsideTheImageAreAcceptedAndCutOff) {
  CameraIntrinsics intrinsics = Ftheta120();
  intrinsics.polynomial_px = {900.0, 0.0, -300.0, 0.0, 0.0};  // f' = 0 at theta = 1, f = 600 px
  const CameraModelPtr camera = Create(intrinsics);
  ASSERT_NE(camera, nullptr);
  const auto project = [&camera](double theta) {
    return camera->ProjectTuned({std::sin(theta), 0.0, std::cos(theta)}, camera->tunable(),
                                nullptr);
  };
  EXPECT_TRUE(project(0.999).has_value());
  EXPECT_FALSE(project(1.001).has_value());
}

TEST(EquidistantCamera, RefusesDistortionThatFoldsInsideTheImage) {
  CameraIntrinsics intrinsics = Equidistant190();
  intrinsics.distortion = {-1.0 / 3.0, 0.0, 0.0, 0.0};  // d theta_d / d theta = 1 - theta^2
  const std::string message = Refusal(intrinsics);
  EXPECT_NE(message.find("equidistant: distortion stops being monotonic at 57.29"),
            std::string::npos)
      << message;
}

TEST(PinholeCamera, RefusesDistortionThatFoldsInsideTheImage) {
  CameraIntrinsics intrinsics = PlumbBob();
  intrinsics.distortion = {-1.0, 0.0, 0.0, 0.0, 0.0};  // stops at r = sqrt(1/3): 30 degrees
  const std::string message = Refusal(intrinsics);
  EXPECT_NE(message.find("plumb_bob: distortion stops being monotonic at 30 deg"),
            std::string::npos)
      << message;
  intrinsics.distortion = {0.0, 0.0, 0.3, 0.0, 0.0};  // tangential terms alone fold as well
  EXPECT_NE(Refusal(intrinsics), "accepted");
}

TEST(PinholeCamera, RefusesARationalPolynomialWithAPoleInsideTheImage) {
  CameraIntrinsics intrinsics = RationalPolynomial();
  intrinsics.distortion = {0.0, 0.0, 0.0, 0.0, 0.0, 5.0, 0.0, 0.0};  // r / (1 + 5 r^2)
  EXPECT_NE(Refusal(intrinsics).find("rational_polynomial: distortion stops being monotonic"),
            std::string::npos);
}

TEST(PinholeCamera, DoesNotFoldPointsBeyondTheMonotonicRadiusIntoTheImage) {
  CameraIntrinsics intrinsics = PlumbBob();
  // r - 0.2 r^3 ends at r = 1.291 (52 degrees), outside this image; at r = 2.236 it is back at 0.
  intrinsics.distortion = {-0.2, 0.0, 0.0, 0.0, 0.0};
  const CameraModelPtr camera = Create(intrinsics);
  ASSERT_NE(camera, nullptr);
  EXPECT_TRUE(camera->ProjectTuned({1.29, 0.0, 1.0}, camera->tunable(), nullptr).has_value());
  EXPECT_FALSE(camera->ProjectTuned({1.30, 0.0, 1.0}, camera->tunable(), nullptr).has_value());
  EXPECT_FALSE(camera->Project({2.2, 0.0, 1.0}).has_value());
  EXPECT_FALSE(camera->Project({0.3, 0.0, -1.0}).has_value());
}

TEST(CameraFactory, NamesModelKeyValueAndBoundOfWhatItRefuses) {
  CameraIntrinsics intrinsics = PlumbBob();
  intrinsics.model = "omni";
  EXPECT_EQ(Refusal(intrinsics),
            "camera model is 'omni', must be ftheta, plumb_bob, rational_polynomial or "
            "equidistant");
  intrinsics = PlumbBob();
  intrinsics.distortion.pop_back();
  EXPECT_EQ(Refusal(intrinsics), "plumb_bob: distortion has 4 numbers, must have 5");
  intrinsics = Ftheta120();
  intrinsics.polynomial_px[0] = -459.0;
  EXPECT_EQ(Refusal(intrinsics), "ftheta: polynomial_px[0] is -459, must be positive");
  intrinsics.polynomial_px[0] = std::nan("");
  EXPECT_EQ(Refusal(intrinsics), "ftheta: polynomial_px[0] is nan, must be finite");
  intrinsics = Ftheta120();
  intrinsics.focal_px = {459.0, 459.0};
  EXPECT_EQ(Refusal(intrinsics), "ftheta: focal_px has 2 numbers, must have 0");
  intrinsics = Equidistant190();
  intrinsics.focal_px[1] = 0.0;
  EXPECT_EQ(Refusal(intrinsics), "equidistant: focal_px[1] is 0, must be positive");
  intrinsics = Equidistant190();
  intrinsics.width_px = 0;
  EXPECT_EQ(Refusal(intrinsics), "equidistant: width_px is 0, must be in [1, 65536]");
  intrinsics = Equidistant190();
  intrinsics.principal_point_px.y() = 5000.0;
  EXPECT_EQ(Refusal(intrinsics),
            "equidistant: principal_point_px[1] is 5000, must be in [-960, 1920]");
}

TEST(CameraModel, RefusesTunedIntrinsicsThatAreNoCamera) {
  const CameraModelPtr camera = Create(Ftheta120());
  EXPECT_FALSE(camera->WithTunable({-1.0, camera->tunable().principal_point_px}).ok());
  EXPECT_FALSE(camera->WithTunable({1.0, {std::nan(""), 0.0}}).ok());
}

/// OpenCV's own projection of random points inside the field of view of the image.
void ExpectAgreesWithOpenCv(const CameraIntrinsics& intrinsics) {
  const CameraModelPtr camera = Create(intrinsics);
  ASSERT_NE(camera, nullptr);
  const cv::Mat k =
      (cv::Mat_<double>(3, 3) << intrinsics.focal_px[0], 0.0, intrinsics.principal_point_px.x(),
       0.0, intrinsics.focal_px[1], intrinsics.principal_point_px.y(), 0.0, 0.0, 1.0);
  std::vector<cv::Point3d> points;
  for (const Eigen::Vector2d& pixel : PixelGrid(*camera, 12)) {
    const auto ray = camera->Unproject(pixel);
    ASSERT_TRUE(ray.has_value());
    if (ray->z() < 0.05) continue;  // OpenCV's fisheye ends at 90 degrees
    points.emplace_back(3.0 * ray->x(), 3.0 * ray->y(), 3.0 * ray->z());
  }
  ASSERT_GT(points.size(), 80u);
  std::vector<cv::Point2d> expected;
  const cv::Vec3d zero(0.0, 0.0, 0.0);
  if (intrinsics.model == "equidistant") {
    cv::fisheye::projectPoints(points, expected, zero, zero, k, intrinsics.distortion);
  } else {
    cv::projectPoints(points, zero, zero, k, intrinsics.distortion, expected);
  }
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto pixel =
        camera->ProjectTuned({points[i].x, points[i].y, points[i].z}, camera->tunable(), nullptr);
    ASSERT_TRUE(pixel.has_value());
    EXPECT_LT((*pixel - Eigen::Vector2d(expected[i].x, expected[i].y)).norm(), 1e-8)
        << intrinsics.model;
  }
}

TEST(CameraModel, ModelsOfRosAgreeWithOpenCv) {
  ExpectAgreesWithOpenCv(PlumbBob());
  ExpectAgreesWithOpenCv(RationalPolynomial());
  ExpectAgreesWithOpenCv(Equidistant190());
}

TEST(LensShape, RadialChangeMovesPixelsByTheCubeOfTheirAngle) {
  constexpr double kChange = 1e-3;
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const CameraModelPtr camera = Create(intrinsics);
    const auto changed = WithRadialChange(*camera, kChange);
    ASSERT_TRUE(changed.ok()) << changed.status().message();
    EXPECT_NEAR(RadialCoefficient(**changed) - RadialCoefficient(*camera), kChange, 1e-12);
    const double theta_rad = 0.05;  // there tan(theta), theta and the distortions are nearly alike
    const Eigen::Vector3d point(std::sin(theta_rad), 0.0, std::cos(theta_rad));
    const double moved_px = (*changed)->Project(point)->x() - camera->Project(point)->x();
    const double expected_px = FocalAtAxisPx(*camera) * kChange * std::pow(theta_rad, 3);
    EXPECT_NEAR(moved_px, expected_px, 0.02 * expected_px) << camera->name();
    EXPECT_NEAR(FocalAtAxisPx(**changed), FocalAtAxisPx(*camera), 1e-4) << camera->name();
  }
}

TEST(LensShape, FocalAtTheAxisFollowsTheFocalScaleWhateverTheDistortion) {
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const CameraModelPtr camera = Create(intrinsics);
    const auto scaled = camera->WithTunable({1.003, camera->tunable().principal_point_px});
    ASSERT_TRUE(scaled.ok());
    EXPECT_NEAR(FocalAtAxisPx(**scaled) / FocalAtAxisPx(*camera), 1.003, 1e-6) << camera->name();
  }
}

TEST(LensShape, RefusesAChangeThatFoldsTheImage) {
  for (const CameraIntrinsics& intrinsics : AllModels()) {
    const auto folded = WithRadialChange(*Create(intrinsics), -1.0);
    EXPECT_EQ(folded.status().code(), Status::Code::kInvalidArgument) << intrinsics.model;
  }
}

}  // namespace
}  // namespace scenecalib
