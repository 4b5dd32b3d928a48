#include "scenecalib/mapping/pose_spline.h"

#include <gtest/gtest.h>

#include "mapping/synthetic_drive.h"

namespace scenecalib {
namespace {

TEST(PoseSpline, FollowsASmoothDrive) {
  const SyntheticDrive drive;
  const PoseSpline spline(drive.Truth(1.0), 0.05);
  for (double t = 0.1; t < 0.9; t += 0.013) {
    const Rigid3 difference = spline.PoseAt(t).Inverse() * drive.WorldFromLidar(t);
    // A B-spline smooths: knot interval squared times acceleration over six.
    EXPECT_LT(difference.translation.norm(), 5e-4);
    EXPECT_LT(LogSo3(difference.rotation).norm(), 2e-4);
  }
}

TEST(PoseSpline, DerivativesAgreeWithDifferences) {
  const SyntheticDrive drive;
  const PoseSpline spline(drive.Truth(1.0), 0.05);
  constexpr double kStepS = 1e-4;
  for (const double t : {0.21, 0.5, 0.77}) {
    const Rigid3 before = spline.PoseAt(t - kStepS);
    const Rigid3 now = spline.PoseAt(t);
    const Rigid3 after = spline.PoseAt(t + kStepS);
    const SplineState state = spline.StateAt(t);
    const Eigen::Vector3d rate =
        LogSo3(before.rotation.conjugate() * after.rotation) / (2.0 * kStepS);
    const Eigen::Vector3d acceleration =
        (after.translation - 2.0 * now.translation + before.translation) / (kStepS * kStepS);
    EXPECT_LT((state.angular_velocity_in_lidar - rate).norm(), 1e-6);
    EXPECT_LT((state.acceleration_in_map - acceleration).norm(), 1e-4);
  }
}

TEST(PoseSpline, BasisPredictsTheEffectOfMovingAControlPose) {
  const SyntheticDrive drive;
  const PoseSpline spline(drive.Truth(1.0), 0.05);
  const double t = 0.412;
  const PoseSpline::Basis basis = spline.BasisAt(t);
  double sum = 0.0;
  for (int j = 0; j < 4; ++j) {
    sum += basis.weight[j];
    PoseSpline moved = spline;
    const Eigen::Vector3d phi(1e-4, -2e-4, 1.5e-4);
    Rigid3& control = moved.controls()[basis.first + j];
    control = Rigid3(ExpSo3(phi) * control.rotation, control.translation + phi);
    const Rigid3 before = spline.PoseAt(t);
    const Rigid3 after = moved.PoseAt(t);
    EXPECT_LT((after.translation - before.translation - basis.weight[j] * phi).norm(), 1e-12);
    const Eigen::Vector3d turn = LogSo3(after.rotation * before.rotation.conjugate());
    EXPECT_LT((turn - basis.weight[j] * phi).norm(), 0.02 * phi.norm());
  }
  EXPECT_NEAR(sum, 1.0, 1e-12);
}

TEST(PoseSpline, SamplesTheWholeTimeIncludingBothEnds) {
  const SyntheticDrive drive;
  const Trajectory truth = drive.Truth(0.73);
  const std::vector<TimedPose> poses = PoseSpline(truth, 0.05).Sample(0.005);
  EXPECT_EQ(poses.front().stamp_ns, truth.start_ns());
  EXPECT_EQ(poses.back().stamp_ns, truth.end_ns());
  EXPECT_TRUE(Trajectory::Create(poses).ok());
}

}  // namespace
}  // namespace scenecalib
