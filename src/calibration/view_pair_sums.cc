#include "view_pair_sums.h"

namespace scenecalib {
namespace {

// Places among a view's own columns, and of the residual behind them.
constexpr int kRotation = 0;
constexpr int kTranslation = 3;
constexpr int kIntrinsics = 6;
constexpr int kTimeOffset = 9;
constexpr int kCorrection = 10;
constexpr int kResidual = ViewColumns::kNumLocal;
// Places among the poses' columns.
constexpr int kPoseIntrinsics = 6;
constexpr int kPoseResidual = 9;

}  // namespace

ViewColumns::ViewColumns(const ViewMotion& motion_by_parameters, const Vector6d& twist,
                         double fraction, const Blocks& blocks)
    : motion(motion_by_parameters), twist_in_lidar(twist) {
  const auto add = [this](int column, int local, int size, double weight) {
    if (column < 0) return;
    if (num_segments > 0) {
      Segment& last = segments[num_segments - 1];
      if (last.column + last.size == column && last.local + last.size == local &&
          last.weight == weight) {
        last.size += size;
        return;
      }
    }
    segments[num_segments++] = {column, local, size, weight};
  };
  add(blocks.rotation, kRotation, 3, 1.0);
  add(blocks.translation, kTranslation, 3, 1.0);
  add(blocks.intrinsics, kIntrinsics, 3, 1.0);
  add(blocks.time_offset, kTimeOffset, 1, 1.0);
  add(blocks.knots[0], kCorrection, 6, 1.0 - fraction);
  add(blocks.knots[1], kCorrection, 6, fraction);
}

ViewPairSums::ViewPairSums(const std::vector<ViewColumns>& views, int num_columns)
    : views_(views),
      target_target_(views.size()),
      half_information_(Eigen::MatrixXd::Zero(num_columns, num_columns)),
      gradient_(Eigen::VectorXd::Zero(num_columns)) {}

void ViewPairSums::StartPair(int source, int target) {
  if (source == source_ && target == target_) return;
  FlushPair();
  if (source != source_) {
    FlushSource();
    source_source_.setZero();
  }
  source_ = source;
  target_ = target;
  source_target_.setZero();
  std::unique_ptr<PoseMatrix>& of_target = target_target_[static_cast<std::size_t>(target)];
  if (of_target == nullptr) of_target = std::make_unique<PoseMatrix>(PoseMatrix::Zero());
  present_target_ = of_target.get();
}

void ViewPairSums::Add(const PoseJacobians& jacobians, const Eigen::Vector2d& residual_px,
                       const Eigen::Matrix2d& weight) {
  using Side = Eigen::Matrix<double, kNumPose, 2>;
  Side source;
  Side target;
  source.topRows<9>().noalias() = jacobians.source.transpose().lazyProduct(weight.transpose());
  target.topRows<9>().noalias() = jacobians.target.transpose().lazyProduct(weight.transpose());
  source.row(kPoseResidual).setZero();
  target.row(kPoseResidual) = weight * residual_px;
  for (int k = 0; k < kNumPose; ++k) {
    source_source_.col(k) += source.col(0) * source(k, 0) + source.col(1) * source(k, 1);
    source_target_.col(k) += source.col(0) * target(k, 0) + source.col(1) * target(k, 1);
    present_target_->col(k) += target.col(0) * target(k, 0) + target.col(1) * target(k, 1);
  }
}

void ViewPairSums::Finish() {
  FlushPair();
  FlushSource();
  for (std::size_t view = 0; view < target_target_.size(); ++view) {
    if (target_target_[view] == nullptr) continue;
    Scatter(views_[view], *target_target_[view], views_[view], 0.5);
    target_target_[view].reset();
  }
  source_ = kNone;
  target_ = kNone;
}

void ViewPairSums::FlushPair() {
  if (target_ == kNone) return;
  Scatter(views_[static_cast<std::size_t>(source_)], source_target_,
          views_[static_cast<std::size_t>(target_)], 1.0);
}

void ViewPairSums::FlushSource() {
  if (source_ == kNone) return;
  const ViewColumns& view = views_[static_cast<std::size_t>(source_)];
  Scatter(view, source_source_, view, 0.5);
}

void ViewPairSums::Scatter(const ViewColumns& rows, const PoseMatrix& sum,
                           const ViewColumns& columns, double factor) {
  // By the columns' parameters first, then by the rows'.
  Eigen::Matrix<double, kNumPose, kResidual + 1> right;
  const Eigen::Matrix<double, kNumPose, 12> by_pose = sum.leftCols<6>().lazyProduct(columns.motion);
  right.leftCols<6>() = by_pose.leftCols<6>();
  right.middleCols<3>(kIntrinsics) = sum.middleCols<3>(kPoseIntrinsics);
  right.col(kTimeOffset) = by_pose.rightCols<6>() * columns.twist_in_lidar;
  right.middleCols<6>(kCorrection) = by_pose.rightCols<6>();
  right.col(kResidual) = sum.col(kPoseResidual);
  Eigen::Matrix<double, ViewColumns::kNumLocal, kResidual + 1> local;
  const Eigen::Matrix<double, 12, kResidual + 1> by_rows =
      rows.motion.transpose().lazyProduct(right.topRows<6>());
  local.topRows<6>() = by_rows.topRows<6>();
  local.middleRows<3>(kIntrinsics) = right.middleRows<3>(kPoseIntrinsics);
  local.row(kTimeOffset) = rows.twist_in_lidar.transpose() * by_rows.bottomRows<6>();
  local.middleRows<6>(kCorrection) = by_rows.bottomRows<6>();

  for (int b = 0; b < columns.num_segments; ++b) {
    const ViewColumns::Segment& across = columns.segments[b];
    for (int j = 0; j < across.size; ++j) {
      double* column = half_information_.col(across.column + j).data();
      for (int a = 0; a < rows.num_segments; ++a) {
        const ViewColumns::Segment& down = rows.segments[a];
        const double weight = factor * across.weight * down.weight;
        const double* from = local.col(across.local + j).data() + down.local;
        for (int i = 0; i < down.size; ++i) column[down.column + i] += weight * from[i];
      }
    }
  }
  // The residual is a column of the targets alone: this is zero for the sums of the sources.
  for (int a = 0; a < rows.num_segments; ++a) {
    const ViewColumns::Segment& down = rows.segments[a];
    gradient_.segment(down.column, down.size) +=
        down.weight * local.col(kResidual).segment(down.local, down.size);
  }
}

}  // namespace scenecalib
