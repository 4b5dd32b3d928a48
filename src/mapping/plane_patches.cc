#include "plane_patches.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <tuple>

#include "scenecalib/base/floor.h"
#include "scenecalib/mapping/voxel_plane_map.h"

namespace scenecalib {
namespace {

constexpr double kMinPatchPoints = 20.0;
constexpr int kMinObservations = 3;
constexpr double kMinUnevennessM = 5e-4;
constexpr std::int64_t kCellOffset = 1 << 17;  // 18 bits per axis: 100 km of 0.4 m cells

/// Sums over the points of one finest cell within one time bin, about the cell's centre. Single
/// precision: there are a million of them, and offsets are below a metre.
struct CellSum {
  std::uint64_t cell = 0;  ///< Morton code, so that an octree node is a contiguous range
  std::int32_t bin = 0;
  std::int32_t laser = 0;  ///< first node of LaserCorrection::Place, if lasers are told apart
  float count = 0.0F;
  float seconds = 0.0F;        ///< sum of times after the bin's start
  float share_of_next = 0.0F;  ///< sum, likewise
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  std::array<float, 6> outer{};  ///< xx, xy, xz, yy, yz, zz

  void Add(const Eigen::Vector3f& o, float seconds_in_bin, float share) {
    count += 1.0F;
    seconds += seconds_in_bin;
    share_of_next += share;
    sum += o;
    outer[0] += o.x() * o.x();
    outer[1] += o.x() * o.y();
    outer[2] += o.x() * o.z();
    outer[3] += o.y() * o.y();
    outer[4] += o.y() * o.z();
    outer[5] += o.z() * o.z();
  }
  PointMoments Moments() const {
    PointMoments moments;
    moments.count = count;
    moments.sum = sum.cast<double>();
    moments.outer << outer[0], outer[1], outer[2], outer[1], outer[3], outer[4], outer[2], outer[4],
        outer[5];
    return moments;
  }
};

/// Finds the cells of one scan by cell, time bin and laser.
class CellTable {
 public:
  explicit CellTable(std::size_t max_cells) {
    std::size_t size = 16;
    while (size < 2 * max_cells) size *= 2;
    slots_.assign(size, kFree);
  }

  /// The entry in `cells`, a new one at its end if need be.
  CellSum& At(std::uint64_t cell, std::int32_t bin, std::int32_t laser,
              std::vector<CellSum>* cells) {
    const std::uint64_t time_and_laser =
        static_cast<std::uint64_t>(bin) << 16 ^ static_cast<std::uint64_t>(laser);
    std::uint64_t hash = (cell + time_and_laser * 0xbf58476d1ce4e5b9ULL) * 0x9e3779b97f4a7c15ULL;
    hash ^= hash >> 32;
    for (std::size_t slot = hash & (slots_.size() - 1);; slot = (slot + 1) & (slots_.size() - 1)) {
      if (slots_[slot] == kFree) {
        slots_[slot] = static_cast<std::uint32_t>(cells->size());
        CellSum& sum = cells->emplace_back();
        sum.cell = cell;
        sum.bin = bin;
        sum.laser = laser;
        return sum;
      }
      CellSum& sum = (*cells)[slots_[slot]];
      if (sum.cell == cell && sum.bin == bin && sum.laser == laser) return sum;
    }
  }

 private:
  static constexpr std::uint32_t kFree = 0xffffffffU;
  std::vector<std::uint32_t> slots_;
};

std::uint64_t SpreadBits(std::uint64_t x) {
  x &= 0x1fffff;
  x = (x | x << 32) & 0x1f00000000ffffULL;
  x = (x | x << 16) & 0x1f0000ff0000ffULL;
  x = (x | x << 8) & 0x100f00f00f00f00fULL;
  x = (x | x << 4) & 0x10c30c30c30c30c3ULL;
  return (x | x << 2) & 0x1249249249249249ULL;
}

std::uint64_t GatherBits(std::uint64_t x) {
  x &= 0x1249249249249249ULL;
  x = (x ^ (x >> 2)) & 0x10c30c30c30c30c3ULL;
  x = (x ^ (x >> 4)) & 0x100f00f00f00f00fULL;
  x = (x ^ (x >> 8)) & 0x1f0000ff0000ffULL;
  x = (x ^ (x >> 16)) & 0x1f00000000ffffULL;
  return (x ^ (x >> 32)) & 0x1fffff;
}

Eigen::Vector3d CellCenter(std::uint64_t cell, double size_m) {
  Eigen::Vector3d center;
  for (int axis = 0; axis < 3; ++axis) {
    const auto index = static_cast<std::int64_t>(GatherBits(cell >> axis)) - kCellOffset;
    center[axis] = (static_cast<double>(index) + 0.5) * size_m;
  }
  return center;
}

/// How points are placed.
struct Placement {
  const LaserCorrection& lasers;
  bool by_laser;
  const PoseTable& table;
};

/// The cells of one scan, in no order.
std::vector<CellSum> SumCells(const PackedScan& scan, const Placement& placement,
                              std::size_t stride, std::size_t phase,
                              const RefinementOptions& options) {
  const PoseTable& table = placement.table;
  const double stamp_s = SecondsBetween(table.start_ns(), scan.stamp_ns());
  CellTable cell_table(scan.size() / stride + 1);
  std::vector<CellSum> cells;
  for (std::size_t i = phase; i < scan.size(); i += stride) {
    const double seconds = stamp_s + scan.time_offset_s(i);
    Eigen::Vector3d in_lidar = scan.position_in_lidar_m(i).cast<double>();
    LaserCorrection::Place lasers;
    if (!placement.lasers.empty()) {
      const LaserCorrection::Place place = placement.lasers.PlaceOf(in_lidar);
      in_lidar = placement.lasers.Apply(in_lidar, place);
      if (placement.by_laser) lasers = place;
    }
    const Eigen::Vector3d in_map = table.Place(in_lidar, seconds);
    std::uint64_t cell = 0;
    Eigen::Vector3f offset;
    for (int axis = 0; axis < 3; ++axis) {
      const std::int64_t index = Floor(in_map[axis] / options.finest_patch_m);
      cell |= SpreadBits(static_cast<std::uint64_t>(index + kCellOffset)) << axis;
      offset[axis] = static_cast<float>(in_map[axis] - (static_cast<double>(index) + 0.5) *
                                                           options.finest_patch_m);
    }
    const auto bin = static_cast<std::int32_t>(Floor(seconds / options.time_bin_s));
    cell_table.At(cell, bin, lasers.first, &cells)
        .Add(offset, static_cast<float>(seconds - bin * options.time_bin_s),
             static_cast<float>(lasers.share_of_next));
  }
  return cells;
}

/// By cell, time bin and laser.
std::vector<CellSum> SumAllCells(const std::vector<const PackedScan*>& scans,
                                 const Placement& placement, const RefinementOptions& options) {
  std::size_t num_points = 0;
  for (const PackedScan* scan : scans) num_points += scan->size();
  const std::size_t stride = num_points / static_cast<std::size_t>(options.max_points) + 1;
  std::vector<std::vector<CellSum>> of_scan(scans.size());
  tbb::parallel_for(std::size_t{0}, scans.size(), [&](std::size_t i) {
    of_scan[i] = SumCells(*scans[i], placement, stride, i % stride, options);
  });
  struct Entry {
    std::uint64_t cell;
    std::int32_t bin;
    std::int32_t laser;
    const CellSum* sum;
  };
  std::vector<Entry> order;
  for (const auto& some : of_scan) {
    for (const CellSum& sum : some) order.push_back({sum.cell, sum.bin, sum.laser, &sum});
  }
  // Consecutive scans may share a bin: a total order, so that the result does not depend on
  // threads.
  tbb::parallel_sort(order.begin(), order.end(), [](const Entry& a, const Entry& b) {
    if (a.cell != b.cell) return a.cell < b.cell;
    if (a.bin != b.bin) return a.bin < b.bin;
    if (a.laser != b.laser) return a.laser < b.laser;
    return std::tie(a.sum->seconds, a.sum->count, a.sum->sum.x()) <
           std::tie(b.sum->seconds, b.sum->count, b.sum->sum.x());
  });
  std::vector<CellSum> cells;
  cells.reserve(order.size());
  for (const Entry& entry : order) cells.push_back(*entry.sum);
  return cells;
}

struct Plane {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();  ///< columns: u, v, normal
  Eigen::Vector3d sigma_m = Eigen::Vector3d::Zero();   ///< across, narrow, wide
};

Plane FitPlane(const PointMoments& moments) {
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(moments.Covariance());
  Plane plane;
  plane.point = moments.Mean();
  plane.sigma_m = eigen.eigenvalues().cwiseMax(0.0).cwiseSqrt();
  const Eigen::Vector3d u = eigen.eigenvectors().col(2);
  const Eigen::Vector3d normal = eigen.eigenvectors().col(0);
  plane.axes << u, normal.cross(u), normal;
  return plane;
}

/// One octree node's search for patches.
class PatchFinder {
 public:
  PatchFinder(const std::vector<CellSum>& cells, const RefinementOptions& options)
      : cells_(cells), options_(options) {}

  void Search(std::size_t begin, std::size_t end, int level,
              std::vector<PlanePatch>* patches) const {
    const double count = Count(begin, end);
    if (count < kMinPatchPoints) return;
    const double size_m = options_.finest_patch_m * (1 << level);
    const Eigen::Vector3d center = CellCenter(cells_[begin].cell >> (3 * level), size_m);
    const Plane plane = FitPlane(Sum(begin, end, center));
    const std::vector<std::size_t> children = Children(begin, end, level);
    const bool planar = plane.sigma_m[0] < options_.max_thickness_m &&
                        plane.sigma_m[1] > 0.1 * size_m &&
                        plane.sigma_m[0] < 0.35 * plane.sigma_m[1];
    if (planar && (level == 0 || !IsCurved(plane, children, level))) {
      PlanePatch patch;
      if (MakePatch(begin, end, center, plane, &patch)) patches->push_back(std::move(patch));
      return;
    }
    if (level == 0) return;
    for (std::size_t i = 0; i + 1 < children.size(); ++i) {
      Search(children[i], children[i + 1], level - 1, patches);
    }
  }

 private:
  double Count(std::size_t begin, std::size_t end) const {
    double count = 0.0;
    for (std::size_t i = begin; i < end; ++i) count += cells_[i].count;
    return count;
  }
  PointMoments MomentsAbout(std::size_t i, const Eigen::Vector3d& reference) const {
    return cells_[i].Moments().Shifted(CellCenter(cells_[i].cell, options_.finest_patch_m) -
                                       reference);
  }
  PointMoments Sum(std::size_t begin, std::size_t end, const Eigen::Vector3d& reference) const {
    PointMoments moments;
    for (std::size_t i = begin; i < end; ++i) moments.Add(MomentsAbout(i, reference));
    return moments;
  }
  /// Bounds of the child nodes: child i is [bounds[i], bounds[i + 1]).
  std::vector<std::size_t> Children(std::size_t begin, std::size_t end, int level) const {
    std::vector<std::size_t> bounds = {begin};
    if (level == 0) return {begin, end};
    for (std::size_t i = begin + 1; i < end; ++i) {
      if (cells_[i].cell >> (3 * level - 3) != cells_[i - 1].cell >> (3 * level - 3)) {
        bounds.push_back(i);
      }
    }
    bounds.push_back(end);
    return bounds;
  }
  /// One plane for all is worse than a plane for each child by more than noise explains.
  bool IsCurved(const Plane& plane, const std::vector<std::size_t>& children, int level) const {
    const double size_m = options_.finest_patch_m * (1 << (level - 1));
    double pooled = 0.0;
    double count = 0.0;
    for (std::size_t i = 0; i + 1 < children.size(); ++i) {
      const Eigen::Vector3d center =
          CellCenter(cells_[children[i]].cell >> (3 * level - 3), size_m);
      const PointMoments moments = Sum(children[i], children[i + 1], center);
      if (moments.count < kMinPatchPoints) continue;
      const double sigma_m = FitPlane(moments).sigma_m[0];
      pooled += moments.count * sigma_m * sigma_m;
      count += moments.count;
    }
    if (count == 0.0) return false;
    const double excess = plane.sigma_m[0] * plane.sigma_m[0] - pooled / count;
    return excess > options_.max_curvature_m * options_.max_curvature_m;
  }
  bool MakePatch(std::size_t begin, std::size_t end, const Eigen::Vector3d& center,
                 const Plane& plane, PlanePatch* patch) const {
    patch->center_m = center + plane.point;
    patch->axes = plane.axes;
    patch->sigma_m = plane.sigma_m[0];
    std::vector<std::size_t> order(end - begin);
    for (std::size_t i = begin; i < end; ++i) order[i - begin] = i;
    const auto is_other = [this](std::size_t a, std::size_t b) {
      return cells_[a].bin != cells_[b].bin || cells_[a].laser != cells_[b].laser;
    };
    std::stable_sort(order.begin(), order.end(), [this](std::size_t a, std::size_t b) {
      return cells_[a].bin != cells_[b].bin ? cells_[a].bin < cells_[b].bin
                                            : cells_[a].laser < cells_[b].laser;
    });
    for (std::size_t i = 0; i < order.size();) {
      PointMoments moments;
      double seconds = 0.0;
      double share_of_next = 0.0;
      const std::size_t first = order[i];
      const std::int32_t bin = cells_[first].bin;
      for (; i < order.size() && !is_other(first, order[i]); ++i) {
        moments.Add(MomentsAbout(order[i], patch->center_m));
        seconds += cells_[order[i]].seconds;
        share_of_next += cells_[order[i]].share_of_next;
      }
      const Eigen::Matrix3d outer = patch->axes.transpose() * moments.outer * patch->axes;
      const Eigen::Vector3d sum = patch->axes.transpose() * moments.sum;
      PatchObservation observation;
      observation.seconds = bin * options_.time_bin_s + seconds / moments.count;
      observation.information << moments.count, sum[0], sum[1], sum[0], outer(0, 0), outer(0, 1),
          sum[1], outer(0, 1), outer(1, 1);
      observation.gradient << sum[2], outer(0, 2), outer(1, 2);
      observation.lasers = {cells_[first].laser, share_of_next / moments.count};
      patch->observations.push_back(observation);
    }
    return static_cast<int>(patch->observations.size()) >= kMinObservations &&
           patch->observations.back().seconds - patch->observations.front().seconds >=
               options_.min_patch_span_s;
  }

  const std::vector<CellSum>& cells_;
  const RefinementOptions& options_;
};

double Median(std::vector<double>* values) {
  if (values->empty()) return 0.0;
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

/// Refits a patch's plane with robust weights of its observations, and sets them.
void WeighObservations(double floor_sigma_m, double unevenness_m, PlanePatch* patch) {
  constexpr int kRounds = 4;
  constexpr double kRobustScale = 2.5;  // of Cauchy's weight, in sigmas
  const double sigma_m = std::max(patch->sigma_m, floor_sigma_m);
  Eigen::Vector3d correction = Eigen::Vector3d::Zero();  // of the plane: offset, slopes
  for (int round = 0; round < kRounds; ++round) {
    Eigen::Matrix3d information = 1e-9 * Eigen::Matrix3d::Identity();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    for (PatchObservation& o : patch->observations) {
      const double variance = sigma_m * sigma_m + o.count() * unevenness_m * unevenness_m;
      const double mean_m = (o.gradient[0] - o.information.row(0).dot(correction)) / o.count();
      const double ratio = mean_m * mean_m * o.count() / variance / (kRobustScale * kRobustScale);
      o.weight = 1.0 / (variance * (1.0 + ratio));
      information += o.weight * o.information;
      gradient += o.weight * o.gradient;
    }
    correction = information.ldlt().solve(gradient);
  }
  for (PatchObservation& o : patch->observations) o.gradient -= o.information * correction;
}

/// How far means of many points of a patch scatter beyond what their number explains.
double EstimateUnevenness(const std::vector<PlanePatch>& patches) {
  std::vector<double> squares;
  std::vector<double> expected;
  for (const PlanePatch& patch : patches) {
    for (const PatchObservation& o : patch.observations) {
      if (o.count() < 15.0) continue;
      const double mean_m = o.gradient[0] / o.count();
      squares.push_back(mean_m * mean_m);
      expected.push_back(patch.sigma_m * patch.sigma_m / o.count());
    }
  }
  constexpr double kMedianOfChiSquare1 = 0.4549;
  const double variance = Median(&squares) / kMedianOfChiSquare1 - Median(&expected);
  return std::sqrt(std::max(variance, kMinUnevennessM * kMinUnevennessM));
}

}  // namespace

double MedianThickness(const std::vector<PlanePatch>& patches) {
  std::vector<double> sigmas;
  for (const PlanePatch& patch : patches) sigmas.push_back(patch.sigma_m);
  return Median(&sigmas);
}

std::vector<PlanePatch> FindPlanePatches(const std::vector<const PackedScan*>& scans,
                                         const LaserCorrection& lasers, bool by_laser,
                                         const PoseTable& map_from_lidar,
                                         const RefinementOptions& options) {
  const std::vector<CellSum> cells =
      SumAllCells(scans, {lasers, by_laser, map_from_lidar}, options);
  const int root_level = options.num_patch_scales - 1;
  std::vector<std::size_t> roots;
  for (std::size_t i = 0; i < cells.size(); ++i) {
    if (i == 0 || cells[i].cell >> (3 * root_level) != cells[i - 1].cell >> (3 * root_level)) {
      roots.push_back(i);
    }
  }
  roots.push_back(cells.size());
  const PatchFinder finder(cells, options);
  std::vector<std::vector<PlanePatch>> of_root(roots.size() - 1);
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, of_root.size(), 64), [&](const auto& range) {
    for (std::size_t i = range.begin(); i < range.end(); ++i) {
      finder.Search(roots[i], roots[i + 1], root_level, &of_root[i]);
    }
  });
  std::vector<PlanePatch> patches;
  for (auto& some : of_root) {
    for (PlanePatch& patch : some) patches.push_back(std::move(patch));
  }
  const double unevenness_m = EstimateUnevenness(patches);
  const double floor_sigma_m = 0.3 * MedianThickness(patches);
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, patches.size(), 256),
                    [&](const auto& range) {
                      for (std::size_t i = range.begin(); i < range.end(); ++i) {
                        WeighObservations(floor_sigma_m, unevenness_m, &patches[i]);
                      }
                    });
  return patches;
}

}  // namespace scenecalib
