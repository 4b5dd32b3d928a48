#include "scenecalib/geometry/trajectory.h"

#include <gtest/gtest.h>

#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

Trajectory QuarterTurn() {
  const Rigid3 start;
  const Rigid3 end(ExpSo3({0.0, 0.0, 1.0}), {2.0, 0.0, 0.0});
  return Trajectory::Create({{1000, start}, {3000, end}}).value();
}

TEST(Trajectory, InterpolatesRotationAndTranslationBetweenPoses) {
  const auto middle = QuarterTurn().Interpolate(2000);
  ASSERT_TRUE(middle.has_value());
  EXPECT_NEAR(middle->translation.x(), 1.0, 1e-12);
  EXPECT_NEAR(RotationAngle(middle->rotation, ExpSo3({0.0, 0.0, 0.5})), 0.0, 1e-12);
}

TEST(Trajectory, ReturnsThePosesThemselvesAtTheirStamps) {
  EXPECT_DOUBLE_EQ(QuarterTurn().Interpolate(1000)->translation.x(), 0.0);
  EXPECT_DOUBLE_EQ(QuarterTurn().Interpolate(3000)->translation.x(), 2.0);
}

TEST(Trajectory, RefusesToExtrapolate) {
  EXPECT_FALSE(QuarterTurn().Interpolate(999).has_value());
  EXPECT_FALSE(QuarterTurn().Interpolate(3001).has_value());
  EXPECT_FALSE(Trajectory().Interpolate(0).has_value());
}

TEST(Trajectory, RefusesStampsThatDoNotIncrease) {
  EXPECT_FALSE(Trajectory::Create({{1000, {}}, {1000, {}}}).ok());
}

TEST(Trajectory, RefusesPosesThatAreNotFinite) {
  Rigid3 broken;
  broken.translation.x() = std::nan("");
  EXPECT_FALSE(Trajectory::Create({{1000, broken}}).ok());
}

}  // namespace
}  // namespace scenecalib
