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

TEST(So3, RightJacobianAgreesWithFiniteDifferences) {
  Random random(4);
  constexpr double kStep = 1e-6;
  const Eigen::Vector3d v = RandomVector(&random, 1.2);
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(axis);
    const Eigen::Vector3d numeric = (LogSo3(ExpSo3(v).conjugate() * ExpSo3(v + step)) -
                                     LogSo3(ExpSo3(v).conjugate() * ExpSo3(v - step))) /
                                    (2.0 * kStep);
    EXPECT_LT((numeric - RightJacobianSo3(v).col(axis)).norm(), 1e-7);
  }
  EXPECT_LT((RightJacobianSo3(v) * RightJacobianInverseSo3(v) - Eigen::Matrix3d::Identity()).norm(),
            1e-9);
}

TEST(So3, LogIsTheSameForBothSignsOfAQuaternion) {
  const Eigen::Quaterniond q = ExpSo3({0.3, -0.2, 0.1});
  Eigen::Quaterniond negative = q;
  negative.coeffs() = -q.coeffs();
  EXPECT_LT((LogSo3(q) - LogSo3(negative)).norm(), 1e-12);
  EXPECT_NEAR(RotationAngle(q, negative), 0.0, 1e-12);
}

TEST(Rigid3, InterpolationTakesTheShortWayRound) {
  Rigid3 a(ExpSo3({0.0, 0.0, 0.2}), {0.0, 0.0, 0.0});
  Rigid3 b(ExpSo3({0.0, 0.0, 0.4}), {1.0, 0.0, 0.0});
  b.rotation.coeffs() = -b.rotation.coeffs();
  const Rigid3 middle = InterpolateRigid3(a, b, 0.5);
  EXPECT_NEAR(RotationAngle(middle.rotation, ExpSo3({0.0, 0.0, 0.3})), 0.0, 1e-9);
  EXPECT_NEAR(middle.translation.x(), 0.5, 1e-12);
}

TEST(Rigid3, LongProductsStayRotations) {
  const Rigid3 step(ExpSo3({0.01, 0.02, -0.015}), {0.1, 0.0, 0.0});
  Rigid3 product;
  for (int i = 0; i < 100000; ++i) product = product * step;
  EXPECT_NEAR(product.rotation.norm(), 1.0, 1e-12);
}

}  // namespace
}  // namespace scenecalib
