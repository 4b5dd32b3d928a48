#include "scenecalib/pipeline/stretch_combination.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/so3.h"
#include "scenecalib/sensor/lens_shape.h"
#include "testing/canyon_scene.h"

namespace scenecalib {
namespace {

using CameraVector = Eigen::Matrix<double, kNumCameraParameters, 1>;

Rig OneCamera() {
  Rig rig;
  rig.cameras = {testing::CanyonCamera("front", 0.0, 680.0, false)};
  return rig;
}

/// The camera moved by the vector of parameters in its own axes.
CameraConfig Moved(const CameraConfig& camera, const CameraVector& change) {
  CameraConfig moved = camera;
  moved.lidar_from_camera =
      camera.lidar_from_camera * Rigid3(ExpSo3(change.segment<3>(3)), change.head<3>());
  const TunableIntrinsics& tunable = camera.model->tunable();
  moved.model = camera.model
                    ->WithTunable({tunable.focal_scale * (1.0 + change[6]),
                                   tunable.principal_point_px + change.segment<2>(7)})
                    .value();
  moved.time_offset_s += change[9];
  return moved;
}

double RadiusNearAxis(const CameraModel& model) {
  return model.Project({0.1, 0.0, 1.0})->x() - model.tunable().principal_point_px.x();
}

CameraVector Difference(const CameraConfig& from, const CameraConfig& to) {
  const Rigid3 change = from.lidar_from_camera.Inverse() * to.lidar_from_camera;
  CameraVector difference;
  difference << change.translation, LogSo3(change.rotation),
      RadiusNearAxis(*to.model) / RadiusNearAxis(*from.model) - 1.0,
      to.model->tunable().principal_point_px - from.model->tunable().principal_point_px,
      to.time_offset_s - from.time_offset_s;
  return difference;
}

/// Deviations of a good stretch: pitch and yaw trade off with the principal point.
CameraMatrix GoodCovariance() {
  CameraVector sigma;
  sigma << 0.003, 0.003, 0.004, 3e-4, 3e-4, 1e-4, 2e-4, 0.4, 0.4, 1e-4;
  CameraMatrix correlation = CameraMatrix::Identity();
  correlation(3, 8) = correlation(8, 3) = 0.95;
  correlation(4, 7) = correlation(7, 4) = -0.95;
  return sigma.asDiagonal() * correlation * sigma.asDiagonal();
}

StretchCalibration Stretch(const std::string& name, const Rig& rig, const CameraVector& change,
                           const CameraMatrix& covariance) {
  StretchCalibration stretch;
  stretch.name = name;
  stretch.result.rig = rig;
  stretch.result.rig.cameras[0] = Moved(rig.cameras[0], change);
  stretch.result.accepted = true;
  stretch.result.cameras.resize(1);
  CameraQuality& quality = stretch.result.cameras[0];
  quality.accepted = true;
  quality.num_tracks = 100;
  const CameraVector sigma = covariance.diagonal().cwiseSqrt();
  quality.stddev.translation_m = sigma.head<3>();
  quality.stddev.rotation_rad = sigma.segment<3>(3);
  quality.stddev.focal_scale = sigma[6];
  quality.stddev.principal_point_px = sigma.segment<2>(7);
  quality.stddev.time_offset_s = sigma[9];
  for (int i = 0; i < kNumCameraParameters; ++i) {
    for (int j = 0; j < kNumCameraParameters; ++j) {
      const double scale = sigma[i] * sigma[j];
      quality.stddev.correlation(i, j) = scale > 0.0 ? covariance(i, j) / scale : i == j;
    }
  }
  return stretch;
}

CameraVector Draw(const CameraMatrix& covariance, Random* random) {
  CameraVector unit;
  for (int i = 0; i < unit.size(); ++i) unit[i] = random->Gaussian();
  return covariance.llt().matrixL() * unit;
}

CameraVector TrueChange() {
  CameraVector change;
  change << 0.04, -0.03, 0.05, 0.006, -0.005, 0.004, 0.002, 1.5, -1.0, 0.0;
  return change;
}

/// Largest error of the combined camera, in a good stretch's standard deviations.
double Sigmas(const Rig& rig, const CalibrationResult& combined) {
  const CameraVector error = Difference(rig.cameras[0], combined.rig.cameras[0]) - TrueChange();
  return error.cwiseQuotient(GoodCovariance().diagonal().cwiseSqrt()).cwiseAbs().maxCoeff();
}

TEST(StretchCombination, MeanOfManyStretchesIsNearerToTheTruthAndSaysHowNear) {
  const Rig rig = OneCamera();
  const CameraMatrix covariance = GoodCovariance();
  constexpr int kNumRuns = 60;
  constexpr int kNumStretches = 5;
  CameraVector normalised = CameraVector::Zero();
  CameraVector over_single = CameraVector::Zero();
  for (int run = 0; run < kNumRuns; ++run) {
    Random random(static_cast<std::uint64_t>(run));
    std::vector<StretchCalibration> stretches;
    for (int k = 0; k < kNumStretches; ++k) {
      stretches.push_back(Stretch("s", rig, TrueChange() + Draw(covariance, &random), covariance));
    }
    const auto combined = CombineStretches(rig, PriorOptions(), stretches);
    ASSERT_TRUE(combined.ok());
    ASSERT_TRUE(combined->accepted) << combined->cameras[0].reasons.front();
    EXPECT_EQ(combined->cameras[0].num_tracks, 100 * kNumStretches);
    const CameraVector error = Difference(rig.cameras[0], combined->rig.cameras[0]) - TrueChange();
    const CameraStddev& stddev = combined->cameras[0].stddev;
    CameraVector sigma;
    sigma << stddev.translation_m, stddev.rotation_rad, stddev.focal_scale,
        stddev.principal_point_px, stddev.time_offset_s;
    normalised += error.cwiseQuotient(sigma).cwiseAbs2() / kNumRuns;
    over_single += error.cwiseAbs2().cwiseQuotient(covariance.diagonal()) / kNumRuns;
  }
  for (int k = 0; k < kNumCameraParameters; ++k) {
    EXPECT_NEAR(over_single[k], 1.0 / kNumStretches, 0.1) << k;
    // Stated deviations are widened by the spread, never narrowed.
    EXPECT_GT(normalised[k], 0.4) << k;
    EXPECT_LT(normalised[k], 1.5) << k;
  }
}

TEST(StretchCombination, WhatOneStretchDoesNotShowComesFromTheOther) {
  const Rig rig = OneCamera();
  PriorOptions prior;
  CameraMatrix straight = GoodCovariance();  // forward offset as unknown as before
  straight(2, 2) = prior.translation_m * prior.translation_m;
  CameraVector at_prior = TrueChange();
  at_prior[2] = 0.0;
  const auto combined = CombineStretches(rig, prior,
                                         {Stretch("straight", rig, at_prior, straight),
                                          Stretch("curves", rig, TrueChange(), GoodCovariance())});
  ASSERT_TRUE(combined.ok());
  ASSERT_TRUE(combined->accepted);
  const CameraVector change = Difference(rig.cameras[0], combined->rig.cameras[0]);
  EXPECT_NEAR(change[2], TrueChange()[2], 1e-4);
  EXPECT_NEAR(combined->cameras[0].stddev.translation_m[2], 0.004, 4e-4);
  EXPECT_NEAR(combined->cameras[0].stddev.translation_m[0], 0.003 / std::sqrt(2.0), 1e-4);
}

TEST(StretchCombination, ThePriorCountsOnceHoweverManyStretchesThereAre) {
  const Rig rig = OneCamera();
  const PriorOptions prior;
  CameraMatrix straight = GoodCovariance();
  straight(2, 2) = prior.translation_m * prior.translation_m;
  CameraVector at_prior = TrueChange();
  at_prior[2] = 0.0;
  const std::vector<StretchCalibration> stretches(5, Stretch("straight", rig, at_prior, straight));
  const auto combined = CombineStretches(rig, prior, stretches);
  ASSERT_TRUE(combined.ok());
  EXPECT_NEAR(combined->cameras[0].stddev.translation_m[2], prior.translation_m, 0.01);
}

TEST(StretchCombination, LensesOfTheStretchesAreAveraged) {
  const Rig rig = OneCamera();
  StretchCalibration first = Stretch("first", rig, TrueChange(), GoodCovariance());
  StretchCalibration second = Stretch("second", rig, TrueChange(), GoodCovariance());
  for (StretchCalibration* stretch : {&first, &second}) {
    CameraConfig& camera = stretch->result.rig.cameras[0];
    camera.model = WithRadialChange(*camera.model, stretch == &first ? 0.004 : 0.008).value();
  }
  const auto combined = CombineStretches(rig, {}, {first, second});
  ASSERT_TRUE(combined.ok());
  EXPECT_NEAR(
      RadialCoefficient(*combined->rig.cameras[0].model) - RadialCoefficient(*rig.cameras[0].model),
      0.006, 1e-6);
}

TEST(StretchCombination, AParameterThatWasHeldStays) {
  const Rig rig = OneCamera();
  CameraMatrix held = GoodCovariance();
  for (const int k : {6, 7, 8, 9}) {
    held.row(k).setZero();
    held.col(k).setZero();
  }
  CameraVector change = TrueChange();
  change.tail<4>().setZero();
  const auto combined = CombineStretches(
      rig, PriorOptions(), {Stretch("a", rig, change, held), Stretch("b", rig, change, held)});
  ASSERT_TRUE(combined.ok());
  const CameraVector result = Difference(rig.cameras[0], combined->rig.cameras[0]);
  // Each stretch's result is taken to lean towards the prior: without that it is a little further.
  EXPECT_LT((result - change).cwiseAbs().maxCoeff(), 1e-4);
  EXPECT_LT((result - change).tail<4>().cwiseAbs().maxCoeff(), 1e-9);
  EXPECT_EQ(combined->cameras[0].stddev.focal_scale, 0.0);
  EXPECT_EQ(combined->cameras[0].stddev.time_offset_s, 0.0);
}

TEST(StretchCombination, AStretchThatContradictsTheOthersIsLeftOutAndNamed) {
  const Rig rig = OneCamera();
  const CameraMatrix covariance = GoodCovariance();
  CameraVector wrong = TrueChange();
  wrong[5] += 10.0 * 1e-4;  // roll, by ten of its deviations
  const auto combined = CombineStretches(
      rig, PriorOptions(),
      {Stretch("first", rig, TrueChange(), covariance), Stretch("second", rig, wrong, covariance),
       Stretch("third", rig, TrueChange(), covariance)});
  ASSERT_TRUE(combined.ok());
  EXPECT_TRUE(combined->accepted);
  EXPECT_LT(Sigmas(rig, *combined), 0.1);
  ASSERT_EQ(combined->cameras[0].reasons.size(), 1U);
  EXPECT_NE(combined->cameras[0].reasons[0].find("second is left out"), std::string::npos);
  EXPECT_NE(combined->cameras[0].reasons[0].find("turn roll"), std::string::npos);
}

TEST(StretchCombination, TwoThatContradictEachOtherLeaveTheCameraAsItWas) {
  const Rig rig = OneCamera();
  CameraVector wrong = TrueChange();
  wrong[0] += 10.0 * 0.003;
  const auto combined = CombineStretches(rig, PriorOptions(),
                                         {Stretch("first", rig, TrueChange(), GoodCovariance()),
                                          Stretch("second", rig, wrong, GoodCovariance())});
  ASSERT_TRUE(combined.ok());
  EXPECT_FALSE(combined->accepted);
  EXPECT_FALSE(combined->cameras[0].accepted);
  EXPECT_NE(combined->cameras[0].reasons[0].find("contradict each other: shift right"),
            std::string::npos);
  EXPECT_EQ(Difference(rig.cameras[0], combined->rig.cameras[0]).norm(), 0.0);
}

TEST(StretchCombination, StretchesThatDidNotAcceptACameraAreNamedAndDoNotCount) {
  const Rig rig = OneCamera();
  StretchCalibration dark = Stretch("dark", rig, CameraVector::Zero(), GoodCovariance());
  dark.result.cameras[0].accepted = false;
  dark.result.cameras[0].reasons = {"too dark"};
  const StretchCalibration good = Stretch("good", rig, TrueChange(), GoodCovariance());
  const auto combined = CombineStretches(rig, PriorOptions(), {dark, good});
  ASSERT_TRUE(combined.ok());
  EXPECT_TRUE(combined->accepted);
  EXPECT_LT(Sigmas(rig, *combined), 0.1);
  EXPECT_EQ(combined->cameras[0].reasons[0], "not accepted on dark: too dark");
  const auto nothing = CombineStretches(rig, PriorOptions(), {dark, dark});
  ASSERT_TRUE(nothing.ok());
  EXPECT_FALSE(nothing->accepted);
  EXPECT_EQ(nothing->cameras[0].reasons[0], "too dark");
}

TEST(StretchCombination, RefusesWhatDoesNotBelongTogether) {
  const Rig rig = OneCamera();
  EXPECT_FALSE(CombineStretches(rig, PriorOptions(), {}).ok());
  StretchCalibration other = Stretch("other", rig, CameraVector::Zero(), GoodCovariance());
  other.result.cameras.resize(2);
  const auto combined = CombineStretches(rig, PriorOptions(), {other});
  ASSERT_FALSE(combined.ok());
  EXPECT_NE(combined.status().message().find("other has another number"), std::string::npos);
}

}  // namespace
}  // namespace scenecalib
