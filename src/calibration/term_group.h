#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "radial_field.h"
#include "scenecalib/calibration/calibration_problem.h"
#include "term_views.h"
#include "view_pair_sums.h"

namespace scenecalib {

/// What a group of terms says about its parameters, robustified: J^T W J, J^T W r and the sum of
/// the robust costs (twice what Ceres calls the cost).
struct GroupEquations {
  Eigen::MatrixXd information;
  Eigen::VectorXd gradient;
  double cost = 0.0;
};

/// What the terms say about parameters beside the group's own, of which every camera has
/// TermGroup::kNumMisfits, one camera after the other: with R the residuals' derivatives by them,
/// J^T W R, R^T W R and R^T W r.
struct MisfitEquations {
  Eigen::MatrixXd coupling;
  Eigen::MatrixXd information;
  Eigen::VectorXd gradient;
};

/// Terms that share most of their parameters: those of one second of target images and one second
/// of source images. Their part of the normal equations is summed up directly, over all threads and
/// always in the same order.
class TermGroup {
 public:
  /// Of every camera: its lens' radial coefficient, the time between its rows, its time offset.
  static constexpr int kNumMisfits = 3;

  /// The problem and its terms must outlive the group.
  TermGroup(const CalibrationProblem& problem, const std::vector<int>& terms);

  /// What the group depends on, and how many values each has.
  const std::vector<double*>& blocks() const { return blocks_; }
  const std::vector<int>& block_sizes() const { return block_sizes_; }
  int num_columns() const { return num_columns_; }
  /// Second of the targets, from the clock's zero.
  Timestamp target_second() const { return target_second_; }

  /// At the values given, one pointer per block. `information` and `gradient` are left alone unless
  /// asked for. False when a term cannot be evaluated there.
  bool Evaluate(double const* const* values, bool with_derivatives,
                GroupEquations* equations) const;

  /// By the misfits, at the present values; `fields` are those of all cameras. False as for
  /// Evaluate.
  bool EvaluateMisfits(const std::vector<RadialField>& fields, MisfitEquations* equations) const;

 private:
  /// What a term's evaluation reads, packed in the order in which it is read.
  struct Entry {
    Eigen::Vector2d target_pixel;
    Eigen::Vector3d plane_point_in_map_m;
    Eigen::Vector3d plane_normal_in_map;
    Eigen::Matrix2d whitening;  ///< by the residual's sigma too
    int source = 0;             ///< index of its view
    int target = 0;
    int ray = 0;
  };
  struct State;

  int AddBlock(double* values, int size);
  void AddCamera(int camera);
  void AddKnots();
  State StateAt(double const* const* values, bool with_derivatives) const;
  bool EvaluateSlice(const State& state, std::size_t first, std::size_t last, bool with_derivatives,
                     GroupEquations* equations) const;

  const CalibrationProblem& problem_;
  std::vector<TermView> views_;
  std::vector<SourcePixel> rays_;
  std::vector<Entry> entries_;  ///< in the order of their views
  std::vector<double*> blocks_;
  std::vector<int> block_sizes_;
  std::vector<ViewColumns::Blocks> camera_columns_;  ///< of all cameras
  std::vector<int> knot_columns_;                    ///< of all knots; -1: not in the group
  int num_columns_ = 0;
  Timestamp target_second_ = 0;
};

/// The terms of a problem by seconds.
std::vector<std::unique_ptr<TermGroup>> GroupTerms(const CalibrationProblem& problem);
/// The same by pieces of surface: cubes of a few metres, by the side that the surface faces.
std::vector<std::unique_ptr<TermGroup>> GroupTermsBySurface(const CalibrationProblem& problem);

}  // namespace scenecalib
