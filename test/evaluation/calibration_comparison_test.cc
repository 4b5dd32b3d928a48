#include "scenecalib/evaluation/calibration_comparison.h"

#include <gtest/gtest.h>

#include "evaluation_fixture.h"

namespace scenecalib {
namespace {

constexpr double kRadPerDeg = 3.14159265358979323846 / 180.0;

/// One accepted camera with 1 mm and 0.01 degrees of standard deviation per axis.
CalibrationResult ResultOf(const CameraConfig& camera) {
  CalibrationResult result;
  result.rig = RigOf({camera});
  result.cameras.resize(1);
  result.cameras[0].accepted = true;
  result.cameras[0].stddev.translation_m.setConstant(0.001);
  result.cameras[0].stddev.rotation_rad.setConstant(0.01 * kRadPerDeg);
  return result;
}

TEST(CalibrationComparison, NamesTheAxisThatMovedAndByHowManySigma) {
  const CalibrationResult first = ResultOf(ForwardCamera("front"));
  const CalibrationResult second =
      ResultOf(Moved(ForwardCamera("front"), {0.0, 0.5 * kRadPerDeg, 0.0}, {0, 0, 0}));
  const auto changes = CompareCalibrations(first, second, {3.0, 1.0});
  ASSERT_EQ(changes.size(), 1u);
  EXPECT_TRUE(changes[0].moved);
  for (const ParameterChange& parameter : changes[0].parameters) {
    EXPECT_EQ(parameter.moved, parameter.parameter == "turn yaw") << parameter.parameter;
    if (parameter.moved) {
      EXPECT_NEAR(parameter.change, 0.5, 1e-6);
      // 0.5 degrees over sqrt(2) times 0.01.
      EXPECT_NEAR(parameter.sigmas, 0.5 / (std::sqrt(2.0) * 0.01), 1e-3);
    }
  }
  EXPECT_NE(FormatChanges(changes).find("front: moved: turn yaw +0.500 deg (35.4 sigma)"),
            std::string::npos)
      << FormatChanges(changes);
}

TEST(CalibrationComparison, AChangeWithinItsDeviationIsNotAMotion) {
  const CalibrationResult first = ResultOf(ForwardCamera("front"));
  const CalibrationResult second =
      ResultOf(Moved(ForwardCamera("front"), {0, 0, 0}, {0.004, 0.0, 0.0}));
  EXPECT_TRUE(CompareCalibrations(first, second, {2.0, 1.0})[0].moved);  // 2.8 sigma
  EXPECT_FALSE(CompareCalibrations(first, second, {3.0, 1.0})[0].moved);
  EXPECT_FALSE(CompareCalibrations(first, second, {2.0, 3.0})[0].moved);  // 0.9 widened ones
}

TEST(CalibrationComparison, ACameraThatWasNotAcceptedIsNotCompared) {
  const CalibrationResult first = ResultOf(ForwardCamera("front"));
  CalibrationResult second = ResultOf(Moved(ForwardCamera("front"), {0, 0, 0}, {1.0, 0, 0}));
  second.cameras[0].accepted = false;
  const auto changes = CompareCalibrations(first, second, {});
  EXPECT_EQ(changes[0].problem, "not accepted in the second calibration");
  EXPECT_FALSE(changes[0].moved);
}

TEST(CalibrationComparison, CamerasThatOneOfThemLacksAreNamed) {
  const auto changes =
      CompareCalibrations(ResultOf(ForwardCamera("front")), ResultOf(ForwardCamera("rear")), {});
  ASSERT_EQ(changes.size(), 2u);
  EXPECT_EQ(changes[0].camera, "front");
  EXPECT_EQ(changes[0].problem, "not in the second calibration");
  EXPECT_EQ(changes[1].camera, "rear");
  EXPECT_EQ(changes[1].problem, "not in the first calibration");
}

}  // namespace
}  // namespace scenecalib
