#include "scenecalib/pipeline/fallback.h"

#include <gtest/gtest.h>

#include "testing/canyon_scene.h"

namespace scenecalib {
namespace {

CalibrationResult ResultOf(bool accepted, double x_m) {
  CalibrationResult result;
  result.rig.cameras = {testing::CanyonCamera("front", 0.0, 680.0, false)};
  result.rig.cameras[0].lidar_from_camera.translation.x() = x_m;
  result.cameras.resize(1);
  result.cameras[0].accepted = accepted;
  return result;
}

TEST(Fallback, ACameraThatWasNotAcceptedKeepsTheEarlierValues) {
  CalibrationResult result = ResultOf(false, 1.0);
  ApplyFallback({{"earlier.yaml", ResultOf(true, 2.0)}}, &result);
  EXPECT_EQ(result.rig.cameras[0].lidar_from_camera.translation.x(), 2.0);
  EXPECT_FALSE(result.cameras[0].accepted);
  EXPECT_EQ(result.cameras[0].reasons.back(), "keeps the values of earlier.yaml");
}

TEST(Fallback, AnAcceptedCameraIsLeftAlone) {
  CalibrationResult result = ResultOf(true, 1.0);
  ApplyFallback({{"earlier.yaml", ResultOf(true, 2.0)}}, &result);
  EXPECT_EQ(result.rig.cameras[0].lidar_from_camera.translation.x(), 1.0);
  EXPECT_TRUE(result.cameras[0].reasons.empty());
}

TEST(Fallback, ACameraThatTheEarlierResultDidNotAcceptEitherKeepsItsInitialValues) {
  CalibrationResult result = ResultOf(false, 1.0);
  ApplyFallback({{"earlier.yaml", ResultOf(false, 2.0)}}, &result);
  EXPECT_EQ(result.rig.cameras[0].lidar_from_camera.translation.x(), 1.0);
  EXPECT_NE(result.cameras[0].reasons.back().find("did not accept it either"), std::string::npos);
}

TEST(Fallback, AnotherCameraOrImageSizeIsNoFallback) {
  CalibrationResult result = ResultOf(false, 1.0);
  CalibrationResult other = ResultOf(true, 2.0);
  other.rig.cameras[0].name = "rear";
  ApplyFallback({{"earlier.yaml", other}}, &result);
  EXPECT_NE(result.cameras[0].reasons.back().find("does not have it"), std::string::npos);
  other.rig.cameras = {testing::CanyonCamera("front", 0.0, 330.0, true)};  // 1280x720
  ApplyFallback({{"earlier.yaml", other}}, &result);
  EXPECT_NE(result.cameras[0].reasons.back().find("another size"), std::string::npos);
  EXPECT_EQ(result.rig.cameras[0].lidar_from_camera.translation.x(), 1.0);
}

TEST(Fallback, TheFirstEarlierCalibrationThatAcceptedTheCameraCounts) {
  CalibrationResult result = ResultOf(false, 1.0);
  const std::vector<EarlierCalibration> earlier = {{"newest", ResultOf(false, 2.0)},
                                                   {"older", ResultOf(true, 3.0)},
                                                   {"oldest", ResultOf(true, 4.0)}};
  EXPECT_EQ(ApplyFallback(earlier, &result), std::vector<bool>{true});
  EXPECT_EQ(result.rig.cameras[0].lidar_from_camera.translation.x(), 3.0);
  EXPECT_EQ(result.cameras[0].reasons, std::vector<std::string>{"keeps the values of older"});
  EXPECT_EQ(StaysInForce(earlier), "; newest stays in force");
}

TEST(Fallback, WithoutAnEarlierCalibrationNothingChanges) {
  CalibrationResult result = ResultOf(false, 1.0);
  EXPECT_EQ(ApplyFallback({}, &result), std::vector<bool>{false});
  EXPECT_EQ(result.rig.cameras[0].lidar_from_camera.translation.x(), 1.0);
  EXPECT_TRUE(result.cameras[0].reasons.empty());
  EXPECT_EQ(StaysInForce({}), "");
}

TEST(Fallback, WhatWasAcceptedOnceStaysInForceUntilItIsAcceptedAnew) {
  CalibrationResult in_force;
  TakeAccepted(ResultOf(false, 1.0), &in_force);
  EXPECT_FALSE(in_force.cameras[0].accepted);
  TakeAccepted(ResultOf(true, 2.0), &in_force);
  EXPECT_TRUE(in_force.accepted);
  TakeAccepted(ResultOf(false, 3.0), &in_force);
  EXPECT_TRUE(in_force.cameras[0].accepted);
  EXPECT_EQ(in_force.rig.cameras[0].lidar_from_camera.translation.x(), 2.0);
  TakeAccepted(ResultOf(true, 4.0), &in_force);
  EXPECT_EQ(in_force.rig.cameras[0].lidar_from_camera.translation.x(), 4.0);
}

TEST(Fallback, AFileThatCannotBeReadIsAnErrorThatNamesIt) {
  Rig rig;
  EXPECT_FALSE(ReadFallback(rig)->has_value());
  rig.fallback_file = "/nowhere/earlier.yaml";
  const auto fallback = ReadFallback(rig);
  ASSERT_FALSE(fallback.ok());
  EXPECT_NE(fallback.status().message().find("/nowhere/earlier.yaml"), std::string::npos);
}

}  // namespace
}  // namespace scenecalib
