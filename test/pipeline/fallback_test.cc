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
  ApplyFallback(ResultOf(true, 2.0), "earlier.yaml", &result);
  EXPECT_EQ(result.rig.cameras[0].lidar_from_camera.translation.x(), 2.0);
  EXPECT_FALSE(result.cameras[0].accepted);
  EXPECT_EQ(result.cameras[0].reasons.back(), "keeps the values of earlier.yaml");
}

TEST(Fallback, AnAcceptedCameraIsLeftAlone) {
  CalibrationResult result = ResultOf(true, 1.0);
  ApplyFallback(ResultOf(true, 2.0), "earlier.yaml", &result);
  EXPECT_EQ(result.rig.cameras[0].lidar_from_camera.translation.x(), 1.0);
  EXPECT_TRUE(result.cameras[0].reasons.empty());
}

TEST(Fallback, ACameraThatTheEarlierResultDidNotAcceptEitherKeepsItsInitialValues) {
  CalibrationResult result = ResultOf(false, 1.0);
  ApplyFallback(ResultOf(false, 2.0), "earlier.yaml", &result);
  EXPECT_EQ(result.rig.cameras[0].lidar_from_camera.translation.x(), 1.0);
  EXPECT_NE(result.cameras[0].reasons.back().find("did not accept it either"), std::string::npos);
}

TEST(Fallback, AnotherCameraOrImageSizeIsNoFallback) {
  CalibrationResult result = ResultOf(false, 1.0);
  CalibrationResult other = ResultOf(true, 2.0);
  other.rig.cameras[0].name = "rear";
  ApplyFallback(other, "earlier.yaml", &result);
  EXPECT_NE(result.cameras[0].reasons.back().find("does not have it"), std::string::npos);
  other.rig.cameras = {testing::CanyonCamera("front", 0.0, 330.0, true)};  // 1280x720
  ApplyFallback(other, "earlier.yaml", &result);
  EXPECT_NE(result.cameras[0].reasons.back().find("another size"), std::string::npos);
  EXPECT_EQ(result.rig.cameras[0].lidar_from_camera.translation.x(), 1.0);
}

}  // namespace
}  // namespace scenecalib
