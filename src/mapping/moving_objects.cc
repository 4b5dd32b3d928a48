#include "moving_objects.h"

#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "range_image.h"

namespace scenecalib {
namespace {

/// Voxels of an object touch at this edge.
constexpr double kObjectVoxel_m = 0.4;
/// A place that changes more often between free and occupied than this is seen through by nature.
constexpr int kMaxChanges = 3;

/// begin[i] is scan i's first point; one more entry than scans.
std::vector<int> ScanBegins(const std::vector<ScenePoint>& points) {
  const int num_scans = points.empty() ? 0 : points.back().scan + 1;
  std::vector<int> begins(num_scans + 1, static_cast<int>(points.size()));
  for (int i = static_cast<int>(points.size()) - 1; i >= 0; --i) begins[points[i].scan] = i;
  for (int scan = num_scans - 1; scan >= 0; --scan) {
    begins[scan] = std::min(begins[scan], begins[scan + 1]);
  }
  return begins;
}

/// Scans of equal spacing, the first and the last among them.
std::vector<int> SpreadScans(int num_scans, int max_scans) {
  const int count = std::min(num_scans, max_scans);
  std::vector<int> scans(count);
  for (int i = 0; i < count; ++i) scans[i] = count == 1 ? 0 : i * (num_scans - 1) / (count - 1);
  return scans;
}

/// What the judging scans said about one place, in their order.
class PlaceHistory {
 public:
  void Add(Visibility visibility) {
    if (visibility == Visibility::kUnknown) return;
    const bool free = visibility == Visibility::kFree;
    if (free) {
      ++num_free_;
      longest_free_ = std::max(longest_free_, ++current_free_);
    } else {
      ++num_occupied_;
      current_free_ = 0;
    }
    if (known_ && free != last_free_) ++num_changes_;
    known_ = true;
    last_free_ = free;
  }

  /// Free for a stretch, and occupied, if at all, in one piece.
  bool Moving(int min_free_scans) const {
    if (longest_free_ < min_free_scans) return false;
    if (num_free_ > 4 * num_occupied_) return true;
    return num_changes_ <= kMaxChanges && longest_free_ >= num_occupied_ / 4;
  }

 private:
  int num_free_ = 0;
  int num_occupied_ = 0;
  int num_changes_ = 0;
  int current_free_ = 0;
  int longest_free_ = 0;
  bool known_ = false;
  bool last_free_ = false;
};

/// Index of each voxel's representative after joining voxels that touch.
std::vector<int> ConnectVoxels(const VoxelGroups& voxels) {
  std::vector<int> parent(voxels.size());
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for (int v = 0; v < voxels.size(); ++v) {
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dz = -1; dz <= 1; ++dz) {
          const std::uint64_t key = NeighborVoxelKey(voxels.keys[v], dx, dy, dz);
          if (key >= voxels.keys[v]) continue;  // the other half is met from the other side
          const int neighbor = voxels.Find(key);
          if (neighbor < 0) continue;
          const int a = root(v);
          const int b = root(neighbor);
          parent[std::max(a, b)] = std::min(a, b);
        }
      }
    }
  }
  for (int v = 0; v < voxels.size(); ++v) parent[v] = root(v);
  return parent;
}

/// Marks the rest of every object of one scan that holds enough moving points.
void GrowToObjects(const std::vector<ScenePoint>& points, int begin, int end,
                   const MovingObjectOptions& options, std::vector<PointLabel>* labels) {
  std::vector<int> indices;
  for (int i = begin; i < end; ++i) {
    if ((*labels)[i] != PointLabel::kGround) indices.push_back(i);
  }
  const VoxelGroups voxels = GroupByVoxel(points, indices, kObjectVoxel_m);
  const std::vector<int> object_of_voxel = ConnectVoxels(voxels);
  struct Object {
    int num_points = 0;
    int num_moving = 0;
    Eigen::AlignedBox3f box;
  };
  std::vector<Object> objects(voxels.size());
  for (int v = 0; v < voxels.size(); ++v) {
    Object& object = objects[object_of_voxel[v]];
    for (int k = voxels.begin[v]; k < voxels.begin[v + 1]; ++k) {
      const int i = voxels.order[k];
      ++object.num_points;
      if ((*labels)[i] == PointLabel::kMoving) ++object.num_moving;
      object.box.extend(points[i].position_m);
    }
  }
  for (int v = 0; v < voxels.size(); ++v) {
    const Object& object = objects[object_of_voxel[v]];
    if (object.num_moving < options.min_moving_share * object.num_points ||
        object.num_moving == 0 || object.box.sizes().maxCoeff() > options.max_object_extent_m) {
      continue;
    }
    for (int k = voxels.begin[v]; k < voxels.begin[v + 1]; ++k) {
      (*labels)[voxels.order[k]] = PointLabel::kMoving;
    }
  }
}

}  // namespace

int RemoveMovingObjects(const std::vector<ScenePoint>& points, const MovingObjectOptions& options,
                        std::vector<PointLabel>* labels) {
  const std::vector<int> scan_begins = ScanBegins(points);
  const int num_scans = static_cast<int>(scan_begins.size()) - 1;
  if (num_scans < 2) return 0;
  const std::vector<int> judges = SpreadScans(num_scans, options.max_test_scans);
  std::vector<std::unique_ptr<RangeImage>> images(judges.size());
  tbb::parallel_for(std::size_t{0}, judges.size(), [&](std::size_t j) {
    images[j] = std::make_unique<RangeImage>(points, *labels, scan_begins[judges[j]],
                                             scan_begins[judges[j] + 1]);
  });

  std::vector<int> structure;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if ((*labels)[i] == PointLabel::kStructure) structure.push_back(static_cast<int>(i));
  }
  const VoxelGroups places = GroupByVoxel(points, structure, options.voxel_size_m);
  tbb::parallel_for(0, places.size(), [&](int v) {
    Eigen::Vector3f center_m = Eigen::Vector3f::Zero();
    for (int k = places.begin[v]; k < places.begin[v + 1]; ++k) {
      center_m += points[places.order[k]].position_m;
    }
    center_m /= static_cast<float>(places.begin[v + 1] - places.begin[v]);
    PlaceHistory history;
    for (const auto& image : images) {
      history.Add(image->Test(center_m, static_cast<float>(options.voxel_size_m),
                              static_cast<float>(options.free_margin_m),
                              static_cast<float>(options.max_test_range_m)));
    }
    if (!history.Moving(options.min_free_scans)) return;
    for (int k = places.begin[v]; k < places.begin[v + 1]; ++k) {
      (*labels)[places.order[k]] = PointLabel::kMoving;
    }
  });
  tbb::parallel_for(0, num_scans, [&](int scan) {
    GrowToObjects(points, scan_begins[scan], scan_begins[scan + 1], options, labels);
  });
  return static_cast<int>(std::count(labels->begin(), labels->end(), PointLabel::kMoving));
}

}  // namespace scenecalib
