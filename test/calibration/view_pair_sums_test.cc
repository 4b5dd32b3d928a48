#include "../../src/calibration/view_pair_sums.h"

#include <gtest/gtest.h>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr int kNumColumns = 40;

template <typename Derived>
void Fill(Random* random, Eigen::MatrixBase<Derived>* matrix) {
  for (Eigen::Index i = 0; i < matrix->rows(); ++i) {
    for (Eigen::Index j = 0; j < matrix->cols(); ++j) (*matrix)(i, j) = random->Gaussian();
  }
}

struct Transfer {
  PoseJacobians jacobians;
  Eigen::Vector2d residual_px;
  Eigen::Matrix2d weight;
};

Transfer MakeTransfer(Random* random) {
  Transfer transfer;
  Fill(random, &transfer.jacobians.source);
  Fill(random, &transfer.jacobians.target);
  Fill(random, &transfer.residual_px);
  Fill(random, &transfer.weight);
  return transfer;
}

/// A view whose correction lies between two knots.
struct View {
  View(Random* random, const ViewColumns::Blocks& blocks_in, double fraction_in)
      : blocks(blocks_in), fraction(fraction_in) {
    Fill(random, &motion);
    Fill(random, &twist);
    columns = ViewColumns(motion, twist, fraction, blocks);
  }

  /// Derivative of the residual by the group's parameters, the plain way.
  Eigen::MatrixXd Jacobian(const Eigen::Matrix<double, 2, 9>& by_pose) const {
    Eigen::MatrixXd jacobian = Eigen::MatrixXd::Zero(2, kNumColumns);
    const auto add = [&](int column, const Eigen::MatrixXd& block) {
      if (column >= 0) jacobian.middleCols(column, block.cols()) += block;
    };
    const Eigen::Matrix<double, 2, 12> by_parameters = by_pose.leftCols<6>() * motion;
    add(blocks.rotation, by_parameters.leftCols<3>());
    add(blocks.translation, by_parameters.middleCols<3>(3));
    add(blocks.intrinsics, by_pose.rightCols<3>());
    add(blocks.time_offset, by_parameters.rightCols<6>() * twist);
    add(blocks.knots[0], (1.0 - fraction) * by_parameters.rightCols<6>());
    add(blocks.knots[1], fraction * by_parameters.rightCols<6>());
    return jacobian;
  }

  ViewColumns::Blocks blocks;
  double fraction = 0.0;
  ViewMotion motion;
  Vector6d twist;
  ViewColumns columns;
};

ViewColumns::Blocks BlocksOf(int camera, int first_knot) {
  ViewColumns::Blocks blocks;
  blocks.rotation = 10 * camera;
  blocks.translation = 10 * camera + 3;
  blocks.intrinsics = 10 * camera + 6;
  blocks.time_offset = 10 * camera + 9;
  blocks.knots[0] = 20 + 6 * first_knot;
  blocks.knots[1] = 26 + 6 * first_knot;
  return blocks;
}

class ViewPairSumsTest : public ::testing::Test {
 protected:
  void Add(const View& source, const View& target, int count) {
    sums_.StartPair(&source.columns, &target.columns);
    for (int i = 0; i < count; ++i) {
      const Transfer transfer = MakeTransfer(&random_);
      sums_.Add(transfer.jacobians, transfer.residual_px, transfer.weight);
      const Eigen::MatrixXd jacobian =
          transfer.weight *
          (source.Jacobian(transfer.jacobians.source) + target.Jacobian(transfer.jacobians.target));
      information_ += jacobian.transpose() * jacobian;
      gradient_ += jacobian.transpose() * transfer.weight * transfer.residual_px;
    }
  }

  void ExpectTheEquationsOfSingleTransfers() {
    sums_.Finish();
    const Eigen::MatrixXd& half = sums_.half_information();
    EXPECT_LT((half + half.transpose() - information_).norm(), 1e-10 * information_.norm());
    EXPECT_LT((sums_.gradient() - gradient_).norm(), 1e-10 * gradient_.norm());
  }

  Random random_{7};
  ViewPairSums sums_{kNumColumns};
  Eigen::MatrixXd information_ = Eigen::MatrixXd::Zero(kNumColumns, kNumColumns);
  Eigen::VectorXd gradient_ = Eigen::VectorXd::Zero(kNumColumns);
};

TEST_F(ViewPairSumsTest, AreTheEquationsOfTheSingleTransfers) {
  const View a(&random_, BlocksOf(0, 0), 0.3);
  const View b(&random_, BlocksOf(1, 1), 0.8);
  const View c(&random_, BlocksOf(0, 1), 0.1);
  Add(a, b, 4);
  Add(a, c, 3);  // the same source again
  Add(b, c, 2);
  Add(c, a, 1);
  ExpectTheEquationsOfSingleTransfers();
}

TEST_F(ViewPairSumsTest, LeaveOutWhatIsNotFree) {
  ViewColumns::Blocks held = BlocksOf(0, 0);
  held.intrinsics = -1;
  held.time_offset = -1;
  held.knots[1] = -1;
  const View a(&random_, held, 0.4);
  const View b(&random_, BlocksOf(1, 0), 0.6);
  Add(a, b, 3);
  ExpectTheEquationsOfSingleTransfers();
  EXPECT_EQ(sums_.gradient().segment(6, 4), Eigen::Vector4d::Zero());
}

TEST_F(ViewPairSumsTest, TakeViewsOfOneCameraAtOneTime) {
  const View a(&random_, BlocksOf(1, 0), 0.5);
  Add(a, a, 3);
  ExpectTheEquationsOfSingleTransfers();
}

TEST_F(ViewPairSumsTest, AreZeroWithoutTransfers) {
  sums_.Finish();
  EXPECT_EQ(sums_.half_information().norm(), 0.0);
  EXPECT_EQ(sums_.gradient().norm(), 0.0);
}

}  // namespace
}  // namespace scenecalib
