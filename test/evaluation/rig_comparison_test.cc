#include "scenecalib/evaluation/rig_comparison.h"

#include <gtest/gtest.h>

#include "evaluation_fixture.h"

namespace scenecalib {
namespace {

TEST(RigComparison, AnExactEstimateHasNoError) {
  const Rig truth = RigOf({ForwardCamera("front")});
  const auto errors = CompareRigs(truth, truth);
  ASSERT_TRUE(errors.ok());
  ASSERT_EQ(errors->size(), 1u);
  EXPECT_LT(errors->front().rotation_rad.norm(), 1e-12);
  EXPECT_LT(errors->front().translation_m.norm(), 1e-12);
  EXPECT_LT(errors->front().reprojection_rms_px, 1e-9);
  EXPECT_EQ(errors->front().num_points, 24 * 24 * 4);
  EXPECT_EQ(errors->front().num_unprojected_points, 0);
}

TEST(RigComparison, RotationAndTranslationAreInTheCamerasAxes) {
  const Eigen::Vector3d rotation_rad(0.001, -0.002, 0.003);
  const Eigen::Vector3d translation_m(0.01, 0.02, -0.03);
  CameraConfig estimate = Moved(ForwardCamera("front"), rotation_rad, translation_m);
  estimate.time_offset_s = 0.004;
  const auto errors = CompareRigs(RigOf({ForwardCamera("front")}), RigOf({estimate}));
  ASSERT_TRUE(errors.ok());
  EXPECT_LT((errors->front().rotation_rad - rotation_rad).norm(), 1e-9);
  EXPECT_LT((errors->front().translation_m - translation_m).norm(), 1e-12);
  EXPECT_DOUBLE_EQ(errors->front().time_offset_s, 0.004);
}

TEST(RigComparison, ReprojectionOfAPrincipalPointErrorIsItsLength) {
  CameraConfig estimate = ForwardCamera("front");
  estimate.model = *estimate.model->WithTunable({1.0, {322.5, 243.5}});
  const auto errors = CompareRigs(RigOf({ForwardCamera("front")}), RigOf({estimate}));
  ASSERT_TRUE(errors.ok());
  EXPECT_NEAR(errors->front().reprojection_rms_px, 5.0, 1e-9);
  EXPECT_NEAR(errors->front().principal_point_px.norm(), 5.0, 1e-9);
  EXPECT_NEAR(errors->front().focal_scale, 0.0, 1e-12);
}

TEST(RigComparison, FocalScaleIsThatOfTheLensWhateverTheModel) {
  for (const CameraIntrinsics& intrinsics :
       {ForwardCamera("front").model->intrinsics(),
        CameraIntrinsics{"ftheta", 640, 480, {}, {319.5, 239.5}, {450.0, 0, 0, 0, 0}, {}}}) {
    CameraConfig truth = ForwardCamera("front");
    truth.model = *CreateCameraModel(intrinsics);
    CameraConfig estimate = truth;
    estimate.model = *truth.model->WithTunable({1.01, truth.model->tunable().principal_point_px});
    const auto errors = CompareRigs(RigOf({truth}), RigOf({estimate}));
    ASSERT_TRUE(errors.ok());
    EXPECT_NEAR(errors->front().focal_scale, 0.01, 1e-12) << intrinsics.model;
  }
}

TEST(RigComparison, CamerasAreMatchedByNameInTheOrderOfTheTruth) {
  const CameraConfig a = ForwardCamera("a");
  const CameraConfig b = Moved(ForwardCamera("b"), {0.0, 1.0, 0.0}, {0.0, 0.0, 0.0});
  const auto errors = CompareRigs(RigOf({a, b}), RigOf({b, ForwardCamera("extra"), a}));
  ASSERT_TRUE(errors.ok());
  EXPECT_EQ(errors->at(0).name, "a");
  EXPECT_EQ(errors->at(1).name, "b");
  EXPECT_LT(errors->at(1).rotation_rad.norm(), 1e-9);
}

TEST(RigComparison, MissingCamerasAndModelsAreNamed) {
  CameraConfig blind = ForwardCamera("front");
  blind.model = nullptr;
  const Rig truth = RigOf({ForwardCamera("front")});
  EXPECT_EQ(CompareRigs(truth, RigOf({ForwardCamera("rear")})).status().message(),
            "camera front of the truth is not in the estimate");
  EXPECT_EQ(CompareRigs(truth, RigOf({blind})).status().message(),
            "camera front has no intrinsics");
}

TEST(RigComparison, PointsThatTheEstimateCannotProjectAreCounted) {
  const CameraConfig turned = Moved(ForwardCamera("front"), {0.0, 1.4, 0.0}, {0.0, 0.0, 0.0});
  const auto errors = CompareRigs(RigOf({ForwardCamera("front")}), RigOf({turned}));
  ASSERT_TRUE(errors.ok());
  EXPECT_GT(errors->front().num_unprojected_points, 0);
  EXPECT_EQ(errors->front().num_points + errors->front().num_unprojected_points, 24 * 24 * 4);
}

}  // namespace
}  // namespace scenecalib
