#include "scenecalib/mapping/laser_correction.h"

#include <algorithm>
#include <cmath>

namespace scenecalib {
namespace {

/// Elevations of some of the points, sines, ascending.
std::vector<double> SampleElevations(const std::vector<const PackedScan*>& scans) {
  constexpr std::size_t kMaxPoints = 400000;
  std::size_t num_points = 0;
  for (const PackedScan* scan : scans) num_points += scan->size();
  const std::size_t stride = num_points / kMaxPoints + 1;
  std::vector<double> sines;
  sines.reserve(num_points / stride + 1);
  std::size_t next = 0;
  for (const PackedScan* scan : scans) {
    for (; next < scan->size(); next += stride) {
      const Eigen::Vector3d point = scan->position_in_lidar_m(next).cast<double>();
      const double range_m = point.norm();
      if (range_m > 0.0) sines.push_back(point.z() / range_m);
    }
    next -= scan->size();
  }
  std::sort(sines.begin(), sines.end());
  return sines;
}

}  // namespace

LaserCorrection::LaserCorrection(const std::vector<const PackedScan*>& scans) {
  constexpr double kRadians = M_PI / 180.0;
  constexpr double kGap = 0.04 * kRadians;      // no laser points there
  constexpr double kSpacing = 0.35 * kRadians;  // of nodes where lasers do not tell apart
  constexpr double kMinShare = 5e-4;            // of the points; fewer say nothing
  const std::vector<double> sines = SampleElevations(scans);
  const auto size = static_cast<double>(sines.size());
  for (std::size_t begin = 0, end = 0; begin < sines.size(); begin = end) {
    end = begin + 1;
    while (end < sines.size() && sines[end] - sines[end - 1] < kGap) ++end;
    const double width = sines[end - 1] - sines[begin];
    const int num_parts = 1 + static_cast<int>(width / kSpacing);
    std::size_t from = begin;
    for (int part = 1; part <= num_parts; ++part) {
      const auto bound = part == num_parts
                             ? sines.begin() + static_cast<std::ptrdiff_t>(end)
                             : std::lower_bound(sines.begin() + static_cast<std::ptrdiff_t>(from),
                                                sines.begin() + static_cast<std::ptrdiff_t>(end),
                                                sines[begin] + width * part / num_parts);
      const auto to = static_cast<std::size_t>(bound - sines.begin());
      const auto count = static_cast<double>(to - from);
      if (count >= kMinShare * size)
        nodes_.push_back({sines[from + (to - from) / 2], count, {0, 0, 0}});
      from = to;
    }
  }
  if (nodes_.size() < 2) nodes_.clear();
  double sum = 0.0;
  for (const Node& node : nodes_) sum += node.share;
  for (Node& node : nodes_) node.share /= sum;
  IndexNodes();
}

void LaserCorrection::IndexNodes() {
  if (nodes_.empty()) return;
  constexpr int kStepsPerNode = 8;
  const std::size_t num_steps = kStepsPerNode * nodes_.size();
  const double first = nodes_.front().sine_of_elevation;
  steps_per_sine_ = static_cast<double>(num_steps) / (nodes_.back().sine_of_elevation - first);
  int node = 0;
  for (std::size_t step = 0; step < num_steps; ++step) {
    const double begin = first + static_cast<double>(step) / steps_per_sine_;
    while (nodes_[static_cast<std::size_t>(node) + 1].sine_of_elevation < begin) ++node;
    node_at_step_.push_back(node);
  }
}

LaserCorrection::Errors LaserCorrection::RootMeanSquare() const {
  Errors squares = Errors::Zero();
  for (const Node& node : nodes_) squares += node.share * node.errors.cwiseAbs2();
  return squares.cwiseSqrt();
}

LaserCorrection::Errors LaserCorrection::MeanSigma() const {
  double squared_shares = 0.0;
  for (const Node& node : nodes_) squared_shares += node.share * node.share;
  return std::sqrt(squared_shares) * RootMeanSquare();
}

void LaserCorrection::Add(const Eigen::VectorXd& step) {
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    nodes_[i].errors += step.segment<3>(static_cast<Eigen::Index>(3 * i));
  }
}

void LaserCorrection::Shrink(const Errors& unreal) {
  const Eigen::Array3d squares = RootMeanSquare().array().square();
  const Eigen::Array3d of_both = squares + unreal.array().square();
  const Errors kept = (of_both > 0.0).select(squares / of_both, 0.0);
  for (Node& node : nodes_) node.errors = kept.cwiseProduct(node.errors);
}

LaserCorrection::Place LaserCorrection::PlaceOf(const Eigen::Vector3d& point_in_lidar_m) const {
  const double range_m = point_in_lidar_m.norm();
  const double sine = range_m > 0.0 ? point_in_lidar_m.z() / range_m : 0.0;
  const double step = (sine - nodes_.front().sine_of_elevation) * steps_per_sine_;
  const auto last_step = static_cast<double>(node_at_step_.size() - 1);
  auto first = static_cast<std::size_t>(
      node_at_step_[static_cast<std::size_t>(std::clamp(step, 0.0, last_step))]);
  // By rounding the step may be one too far.
  while (first > 0 && nodes_[first].sine_of_elevation > sine) --first;
  while (first + 2 < nodes_.size() && nodes_[first + 1].sine_of_elevation <= sine) ++first;
  const double begin = nodes_[first].sine_of_elevation;
  const double share = (sine - begin) / (nodes_[first + 1].sine_of_elevation - begin);
  return {static_cast<int>(first), std::clamp(share, 0.0, 1.0)};
}

LaserCorrection::Jacobian LaserCorrection::JacobianAt(const Eigen::Vector3d& point_in_lidar_m) {
  const double range_m = std::max(point_in_lidar_m.norm(), 1e-6);
  const double across_m = std::max(point_in_lidar_m.head<2>().norm(), 1e-6);
  const double slope = point_in_lidar_m.z() / across_m;
  Jacobian jacobian;
  jacobian.col(0) = point_in_lidar_m / range_m;
  jacobian.col(1) << -slope * point_in_lidar_m.x(), -slope * point_in_lidar_m.y(), across_m;
  jacobian.col(2) << -point_in_lidar_m.y(), point_in_lidar_m.x(), 0.0;
  return jacobian;
}

Eigen::Vector3d LaserCorrection::Apply(const Eigen::Vector3d& point_in_lidar_m) const {
  if (nodes_.empty()) return point_in_lidar_m;
  return Apply(point_in_lidar_m, PlaceOf(point_in_lidar_m));
}

Eigen::Vector3d LaserCorrection::Apply(const Eigen::Vector3d& point_in_lidar_m,
                                       const Place& place) const {
  const auto first = static_cast<std::size_t>(place.first);
  const Errors errors = (1.0 - place.share_of_next) * nodes_[first].errors +
                        place.share_of_next * nodes_[first + 1].errors;
  return point_in_lidar_m + JacobianAt(point_in_lidar_m) * errors;
}

}  // namespace scenecalib
