#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "scenecalib/calibration/transfer_error.h"

namespace scenecalib {

/// How a view's pose and intrinsics depend on the parameters that a group solves for.
struct ViewColumns {
  /// First columns of the view's blocks; -1 where a block is not free.
  struct Blocks {
    int rotation = -1;
    int translation = -1;
    int intrinsics = -1;
    int time_offset = -1;
    int knots[2] = {-1, -1};
  };
  /// Columns of the group that are a multiple of columns of the view.
  struct Segment {
    int column = 0;
    int local = 0;
    int size = 0;
    double weight = 1.0;
  };
  /// The view's own columns: rotation, translation, intrinsics, time offset, correction.
  static constexpr int kNumLocal = 16;

  ViewColumns() = default;
  /// `fraction` is where the view lies between its two knots.
  ViewColumns(const ViewMotion& motion_by_parameters, const Vector6d& twist, double fraction,
              const Blocks& blocks);

  ViewMotion motion;
  Vector6d twist_in_lidar;
  Segment segments[6];
  int num_segments = 0;
};

/// Sums up the normal equations of transfers between pairs of views. All transfers of a pair share
/// the two poses, so they are summed by the poses (docs/math.md) and turned into equations of the
/// parameters once a pair (of two views) and once a view (with itself).
class ViewPairSums {
 public:
  /// The views outlive the sums.
  ViewPairSums(const std::vector<ViewColumns>& views, int num_columns);

  /// Transfers to follow are between these two views.
  void StartPair(int source, int target);
  /// A transfer with what multiplies its residual (whitening and robust weight).
  void Add(const PoseJacobians& jacobians, const Eigen::Vector2d& residual_px,
           const Eigen::Matrix2d& weight);
  /// To be called after the last transfer.
  void Finish();

  /// J^T J = half_information + half_information^T.
  const Eigen::MatrixXd& half_information() const { return half_information_; }
  const Eigen::VectorXd& gradient() const { return gradient_; }

 private:
  /// Turn, shift, intrinsics and, of the targets, the residual.
  static constexpr int kNumPose = 10;
  using PoseMatrix = Eigen::Matrix<double, kNumPose, kNumPose>;

  static constexpr int kNone = -1;

  void FlushPair();
  void FlushSource();
  void Scatter(const ViewColumns& rows, const PoseMatrix& sum, const ViewColumns& columns,
               double factor);

  const std::vector<ViewColumns>& views_;
  int source_ = kNone;
  int target_ = kNone;
  PoseMatrix source_source_;
  PoseMatrix source_target_;
  std::vector<std::unique_ptr<PoseMatrix>> target_target_;  ///< by target; null: none yet
  PoseMatrix* present_target_ = nullptr;
  Eigen::MatrixXd half_information_;
  Eigen::VectorXd gradient_;
};

}  // namespace scenecalib
