#include "degenerate_directions.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace scenecalib {
namespace {

constexpr double kMaxNoiseShare = 0.5;

}  // namespace

DegenerateDirections::DegenerateDirections(const std::vector<PlanePatch>& patches,
                                           double duration_s) {
  const auto num_blocks = static_cast<std::size_t>(std::max(1.0, std::ceil(duration_s)));
  std::vector<Eigen::Matrix3d> information(num_blocks, Eigen::Matrix3d::Zero());
  std::vector<Eigen::Matrix3d> of_noise(num_blocks, Eigen::Matrix3d::Zero());
  for (const PlanePatch& patch : patches) {
    Eigen::Matrix3d plane = Eigen::Vector3d(1e-6, 1.0, 1.0).asDiagonal();
    for (const PatchObservation& o : patch.observations) plane += o.weight * o.information;
    // Slopes along u and v are the normal's errors along them.
    const Eigen::Matrix2d slopes = plane.inverse().bottomRightCorner<2, 2>();
    const Eigen::Matrix<double, 3, 2> in_plane = patch.axes.leftCols<2>();
    const Eigen::Matrix3d normal_covariance = in_plane * slopes * in_plane.transpose();
    const Eigen::Vector3d normal = patch.axes.col(2);
    for (const PatchObservation& o : patch.observations) {
      const auto block =
          std::min(static_cast<std::size_t>(std::max(o.seconds, 0.0)), num_blocks - 1);
      information[block] += o.weight * o.count() * normal * normal.transpose();
      of_noise[block] += o.weight * o.count() * normal_covariance;
    }
  }
  int num_degenerate = 0;
  for (std::size_t block = 0; block < num_blocks; ++block) {
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(information[block]);
    Eigen::Matrix3d projection = Eigen::Matrix3d::Identity();
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector3d direction = eigen.eigenvectors().col(i);
      const double noise = direction.dot(of_noise[block] * direction);
      if (noise < kMaxNoiseShare * eigen.eigenvalues()[i]) continue;
      projection -= direction * direction.transpose();
    }
    if (!projection.isIdentity()) ++num_degenerate;
    projections_.push_back(projection);
  }
  share_ = static_cast<double>(num_degenerate) / static_cast<double>(num_blocks);
}

Eigen::Matrix3d DegenerateDirections::Projection(double seconds) const {
  if (projections_.empty()) return Eigen::Matrix3d::Identity();
  const auto block = static_cast<std::size_t>(std::max(seconds, 0.0));
  return projections_[std::min(block, projections_.size() - 1)];
}

}  // namespace scenecalib
