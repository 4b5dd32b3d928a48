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
  int AddView(const ViewColumns::Blocks& blocks, double fraction) {
    views_.emplace_back(&random_, blocks, fraction);
    return static_cast<int>(views_.size()) - 1;
  }

  void AddPair(int source, int target, int count) { pairs_.push_back({source, target, count}); }

  void ExpectTheEquationsOfSingleTransfers() {
    std::vector<ViewColumns> columns;
    for (const View& view : views_) columns.push_back(view.columns);
    ViewPairSums sums(columns, kNumColumns);
    Eigen::MatrixXd information = Eigen::MatrixXd::Zero(kNumColumns, kNumColumns);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(kNumColumns);
    for (const Pair& pair : pairs_) {
      const View& source = views_[static_cast<std::size_t>(pair.source)];
      const View& target = views_[static_cast<std::size_t>(pair.target)];
      sums.StartPair(pair.source, pair.target);
      for (int i = 0; i < pair.count; ++i) {
        const Transfer transfer = MakeTransfer(&random_);
        sums.Add(transfer.jacobians, transfer.residual_px, transfer.weight);
        const Eigen::MatrixXd jacobian =
            transfer.weight * (source.Jacobian(transfer.jacobians.source) +
                               target.Jacobian(transfer.jacobians.target));
        information += jacobian.transpose() * jacobian;
        gradient += jacobian.transpose() * transfer.weight * transfer.residual_px;
      }
    }
    sums.Finish();
    const Eigen::MatrixXd& half = sums.half_information();
    EXPECT_LE((half + half.transpose() - information).norm(), 1e-10 * information.norm());
    EXPECT_LE((sums.gradient() - gradient).norm(), 1e-10 * gradient.norm());
    gradient_ = sums.gradient();
  }

  struct Pair {
    int source = 0;
    int target = 0;
    int count = 0;
  };
  Random random_{7};
  std::vector<View> views_;
  std::vector<Pair> pairs_;
  Eigen::VectorXd gradient_;
};

TEST_F(ViewPairSumsTest, AreTheEquationsOfTheSingleTransfers) {
  const int a = AddView(BlocksOf(0, 0), 0.3);
  const int b = AddView(BlocksOf(1, 1), 0.8);
  const int c = AddView(BlocksOf(0, 1), 0.1);
  AddPair(a, b, 4);
  AddPair(a, c, 3);  // the same source again
  AddPair(b, c, 2);  // the same target again
  AddPair(c, a, 1);
  AddPair(a, b, 2);  // the same pair, but not in a row
  ExpectTheEquationsOfSingleTransfers();
}

TEST_F(ViewPairSumsTest, LeaveOutWhatIsNotFree) {
  ViewColumns::Blocks held = BlocksOf(0, 0);
  held.intrinsics = -1;
  held.time_offset = -1;
  held.knots[1] = -1;
  AddPair(AddView(held, 0.4), AddView(BlocksOf(1, 0), 0.6), 3);
  ExpectTheEquationsOfSingleTransfers();
  EXPECT_EQ(gradient_.segment(6, 4), Eigen::Vector4d::Zero());
}

TEST_F(ViewPairSumsTest, TakeViewsOfOneCameraAtOneTime) {
  const int a = AddView(BlocksOf(1, 0), 0.5);
  AddPair(a, a, 3);
  ExpectTheEquationsOfSingleTransfers();
}

TEST_F(ViewPairSumsTest, AreZeroWithoutTransfers) {
  AddView(BlocksOf(1, 0), 0.5);
  ExpectTheEquationsOfSingleTransfers();
  EXPECT_EQ(gradient_.norm(), 0.0);
}

}  // namespace
}  // namespace scenecalib
