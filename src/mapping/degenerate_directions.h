#pragma once

#include <Eigen/Core>
#include <vector>

#include "plane_patches.h"

namespace scenecalib {

/// Directions along which the lidar does not see the motion (a tunnel, an open field), for each
/// second of the drive.
///
/// No patch's normal is exact. Where all true normals are at right angles to a direction, their
/// noise still pretends to measure along it, and holds the trajectory to wherever it was placed
/// before. So the information along a direction is compared with what the normals' noise alone
/// would give: a direction is degenerate when noise explains half of it.
class DegenerateDirections {
 public:
  /// None anywhere.
  DegenerateDirections() = default;
  DegenerateDirections(const std::vector<PlanePatch>& patches, double duration_s);

  /// Removes from a vector what lies along the degenerate directions of a time.
  Eigen::Matrix3d Projection(double seconds) const;
  /// Share of the drive's seconds with a degenerate direction.
  double share() const { return share_; }

 private:
  std::vector<Eigen::Matrix3d> projections_;  ///< one per second
  double share_ = 0.0;
};

}  // namespace scenecalib
