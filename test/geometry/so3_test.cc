#include "scenecalib/geometry/so3.h"

#include <gtest/gtest.h>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

Eigen::Vector3d RandomVector(Random* random, double length) {
  const Eigen::Vector3d v(random->Gaussian(), random->Gaussian(), random->Gaussian());
  return length * v.normalized();
}

TEST(So3, LogInvertsExpFromTinyToAlmostHalfATurn) {
  Random random(1);
  for (const double angle : {0.0, 1e-9, 1e-6, 1e-4, 0.1, 1.0, 3.1}) {
    const Eigen::Vector3d v = RandomVector(&random, angle);
    EXPECT_LT((LogSo3(ExpSo3(v)) - v).norm(), 1e-10) << "angle " << angle;
  }
}

TEST(So3, LeftJacobianAgreesWithFiniteDifferences) {
  Random random(2);
  constexpr double kStep = 1e-6;
  for (const double angle : {1e-7, 1e-3, 0.3, 2.0}) {
    const Eigen::Vector3d v = RandomVector(&random, angle);
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(axis);
      const Eigen::Vector3d numeric = (LogSo3(ExpSo3(v + step) * ExpSo3(v).conjugate()) -
                                       LogSo3(ExpSo3(v - step) * ExpSo3(v).conjugate())) /
                                      (2.0 * kStep);
      EXPECT_LT((numeric - LeftJacobianSo3(v).col(axis)).norm(), 1e-7);
    }
    EXPECT_LT((LeftJacobianSo3(v) * LeftJacobianInverseSo3(v) - Eigen::Matrix3d::Identity()).norm(),
              1e-9);
  }
}

TEST(Rigid3, NeighbouringFramesCancel) {
  Random random(3);
  const Rigid3 c_from_b(ExpSo3(RandomVector(&random, 1.0)), RandomVector(&random, 2.0));
  const Rigid3 b_from_a(ExpSo3(RandomVector(&random, 2.0)), RandomVector(&random, 3.0));
  const Eigen::Vector3d point_in_a = RandomVector(&random, 5.0);
  EXPECT_LT((((c_from_b * b_from_a) * point_in_a) - (c_from_b * (b_from_a * point_in_a))).norm(),
            1e-12);
  EXPECT_LT(((b_from_a.Inverse() * (b_from_a * point_in_a)) - point_in_a).norm(), 1e-12);
}

}  // namespace
}  // namespace scenecalib
