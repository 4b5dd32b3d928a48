#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "scenecalib/mapping/packed_scan.h"

namespace scenecalib {

/// What a spinning lidar's lasers measure wrong, by the elevation at which a point is reported:
/// three numbers at each of some elevations (nodes), linear in between. Nodes are found from the
/// scans, one for every laser where lasers tell apart, so that no ring numbers are needed.
class LaserCorrection {
 public:
  /// What to add: range (m), elevation and azimuth (rad). Azimuth is counter-clockwise about z.
  using Errors = Eigen::Vector3d;
  /// Columns: by how much a point moves per metre and radian of Errors.
  using Jacobian = Eigen::Matrix3d;

  /// Corrects nothing.
  LaserCorrection() = default;
  /// Nodes where the scans have points; nothing to correct yet.
  explicit LaserCorrection(const std::vector<const PackedScan*>& scans);

  bool empty() const { return nodes_.empty(); }
  std::size_t num_nodes() const { return nodes_.size(); }

  struct Node {
    double sine_of_elevation = 0.0;
    double share = 0.0;  ///< of the points; one in sum
    Errors errors = Errors::Zero();
  };
  const std::vector<Node>& nodes() const { return nodes_; }
  /// Root mean square over the points.
  Errors RootMeanSquare() const;
  /// Standard deviation of the lasers' mean error, which the data do not show (it is held at zero),
  /// from how much the lasers differ.
  Errors MeanSigma() const;
  /// Adds a step to every node: range, elevation and azimuth of the first node, of the second, ...
  void Add(const Eigen::VectorXd& step);
  /// Scales range, elevation and azimuth by v / (v + unreal²), v their mean square over the points:
  /// the best estimate where `unreal` (root mean square) of what was found is the scene's and not
  /// the lasers' (James and Stein, Berkeley Symposium 1961). Lasers that differ much keep theirs.
  void Shrink(const Errors& unreal);

  /// The two nodes that a point counts to: `first`, with 1 - share_of_next, and the one after it.
  struct Place {
    int first = 0;
    double share_of_next = 0.0;
  };
  Place PlaceOf(const Eigen::Vector3d& point_in_lidar_m) const;
  static Jacobian JacobianAt(const Eigen::Vector3d& point_in_lidar_m);

  Eigen::Vector3d Apply(const Eigen::Vector3d& point_in_lidar_m) const;
  /// The same where the point's place is known.
  Eigen::Vector3d Apply(const Eigen::Vector3d& point_in_lidar_m, const Place& place) const;

 private:
  void IndexNodes();

  std::vector<Node> nodes_;  ///< by elevation; two or more, or none
  /// For equal steps of the sine of elevation, from the first node's to the last one's, the last
  /// node that lies before the step's begin: millions of points ask for theirs.
  std::vector<int> node_at_step_;
  double steps_per_sine_ = 0.0;
};

}  // namespace scenecalib
