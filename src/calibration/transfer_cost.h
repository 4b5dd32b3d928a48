#pragma once

#include <ceres/cost_function.h>

#include <vector>

#include "scenecalib/calibration/calibration_problem.h"

namespace scenecalib {

/// Ceres cost of one TransferTerm with analytic Jacobians. Its parameter blocks are those of the
/// two cameras (once, when source and target are one camera) and of the trajectory's knots that are
/// free; what is not free is read from the state at construction.
class TransferCost : public ceres::CostFunction {
 public:
  /// All pointers must outlive the cost. `scale` multiplies the whitened residual.
  TransferCost(const TransferTerm* term, std::vector<CameraParameters>* cameras,
               TrajectoryCorrection* correction, const FreeParameters& free, double scale);

  /// The blocks in the order that Evaluate expects.
  const std::vector<double*>& parameter_blocks() const { return blocks_; }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override;

 private:
  enum class Kind { kRotation, kTranslation, kIntrinsics, kTimeOffset, kKnot };
  struct Block {
    Kind kind;
    int owner;  // camera or knot
  };

  void AddCamera(int camera);
  void AddKnot(int knot);
  void AddBlock(Kind kind, int owner, double* values, int size);
  void FillJacobian(const TransferJacobians& all, const Block& block, double* out) const;
  double KnotWeight(const TrajectoryCorrection::Place& place, int knot) const;

  const TransferTerm* term_;
  std::vector<CameraParameters>* cameras_;
  TrajectoryCorrection* correction_;
  FreeParameters free_;
  double scale_;
  std::vector<Block> layout_;
  std::vector<double*> blocks_;
};

}  // namespace scenecalib
