#include "moving_objects.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <memory>

#include "range_image.h"
#include "scan_objects.h"

namespace scenecalib {
namespace {

/// A place that changes more often between free and occupied than this is seen through by nature.
constexpr int kMaxChanges = 3;
/// A place that so many judging scans found occupied, and never free for long, is static.
constexpr int kMinStaticScans = 8;

/// begin[i] is scan i's first point; one more entry than scans.
std::vector<int> ScanBegins(const std::vector<LidarReturn>& points) {
  const int num_scans = points.empty() ? 0 : points.back().scan + 1;
  std::vector<int> begins(num_scans + 1, static_cast<int>(points.size()));
  for (int i = static_cast<int>(points.size()) - 1; i >= 0; --i) begins[points[i].scan] = i;
  for (int scan = num_scans - 1; scan >= 0; --scan) {
    begins[scan] = std::min(begins[scan], begins[scan + 1]);
  }
  return begins;
}

/// The scans that judge: spread along the drive, and over the time of a standing vehicle.
std::vector<int> JudgingScans(const std::vector<LidarReturn>& points,
                              const std::vector<int>& scan_begins,
                              const MovingObjectOptions& options) {
  std::vector<int> judges;
  for (int scan = 0; scan + 1 < static_cast<int>(scan_begins.size()); ++scan) {
    if (scan_begins[scan] == scan_begins[scan + 1]) continue;
    if (!judges.empty()) {
      const float moved_m =
          (points[scan_begins[scan]].origin_m - points[scan_begins[judges.back()]].origin_m).norm();
      if (moved_m < options.test_spacing_m && scan - judges.back() < options.test_spacing_scans) {
        continue;
      }
    }
    judges.push_back(scan);
  }
  return judges;
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

  /// Moving: free for a stretch, and occupied, if at all, in one piece. Static: occupied for longer
  /// than what drives by needs.
  PlaceKind Kind(int min_free_scans) const {
    if (longest_free_ >= min_free_scans &&
        (num_free_ > 4 * num_occupied_ ||
         (num_changes_ <= kMaxChanges && longest_free_ >= num_occupied_ / 4))) {
      return PlaceKind::kMoving;
    }
    return num_occupied_ >= kMinStaticScans ? PlaceKind::kStatic : PlaceKind::kUnknown;
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

/// Ground returns within this of a moving object's returns are its lowest parts.
constexpr double kFootprint_m = 0.2;

/// Marks the returns of moving objects, and what the ground segmentation took of their lowest
/// parts.
void MarkObjects(const std::vector<LidarReturn>& points, const std::vector<ScanObject>& objects,
                 int begin, int end, std::vector<PointLabel>* labels) {
  std::vector<int> moving;
  for (const ScanObject& object : objects) {
    if (object.moving) moving.insert(moving.end(), object.points.begin(), object.points.end());
  }
  if (moving.empty()) return;
  for (const int i : moving) (*labels)[i] = PointLabel::kMoving;
  const VoxelGroups voxels = GroupByVoxel(points, moving, kFootprint_m);
  const float inverse_edge = static_cast<float>(1.0 / kFootprint_m);
  for (int i = begin; i < end; ++i) {
    if ((*labels)[i] != PointLabel::kGround) continue;
    const std::uint64_t key = VoxelKey(points[i].position_m, inverse_edge);
    bool below = false;
    for (int dz = 0; dz <= 1 && !below; ++dz) {
      below = voxels.Find(NeighborVoxelKey(key, 0, 0, dz)) >= 0;
    }
    if (below) (*labels)[i] = PointLabel::kMoving;
  }
}

}  // namespace

int RemoveMovingObjects(const std::vector<LidarReturn>& points, const MovingObjectOptions& options,
                        std::vector<PointLabel>* labels) {
  const std::vector<int> scan_begins = ScanBegins(points);
  const int num_scans = static_cast<int>(scan_begins.size()) - 1;
  if (num_scans < 2) return 0;
  const std::vector<int> judges = JudgingScans(points, scan_begins, options);
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
  std::vector<PlaceKind> kinds(points.size(), PlaceKind::kUnknown);
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
    const PlaceKind kind = history.Kind(options.min_free_scans);
    for (int k = places.begin[v]; k < places.begin[v + 1]; ++k) kinds[places.order[k]] = kind;
  });
  std::vector<std::vector<ScanObject>> objects(num_scans);
  tbb::parallel_for(0, num_scans, [&](int scan) {
    objects[scan] =
        FindScanObjects(points, *labels, kinds, scan_begins[scan], scan_begins[scan + 1], options);
  });
  FollowMovingObjects(&objects);
  tbb::parallel_for(0, num_scans, [&](int scan) {
    for (int i = scan_begins[scan]; i < scan_begins[scan + 1]; ++i) {
      if (kinds[i] == PlaceKind::kMoving) (*labels)[i] = PointLabel::kMoving;
    }
    MarkObjects(points, objects[scan], scan_begins[scan], scan_begins[scan + 1], labels);
  });
  return static_cast<int>(std::count(labels->begin(), labels->end(), PointLabel::kMoving));
}

}  // namespace scenecalib
