#include "scan_objects.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

namespace scenecalib {
namespace {

/// Voxels of an object touch at this edge.
constexpr double kObjectVoxel_m = 0.4;
/// Fewer returns are no object to follow.
constexpr int kMinPointsToFollow = 10;
/// How far from its predicted place an object may be met, beside a share of its step.
constexpr float kMaxMiss_m = 0.6F;
constexpr float kMaxMissShare = 0.3F;
/// A track ends after so many scans without its object.
constexpr int kMaxMissed = 3;
/// Farthest step between scans before the first velocity is known.
constexpr float kMaxFirstStep_m = 4.0F;

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

/// A moving object on its way through the scans.
struct Track {
  Eigen::Vector3f centroid_m = Eigen::Vector3f::Zero();
  Eigen::Vector3f size_m = Eigen::Vector3f::Zero();
  std::optional<Eigen::Vector3f> step_m;  ///< per scan; none until it was met twice
  int num_missed = 0;

  Eigen::Vector3f Predicted() const {
    return centroid_m + static_cast<float>(num_missed + 1) *
                            step_m.value_or(Eigen::Vector3f(Eigen::Vector3f::Zero()));
  }
  float MaxMiss() const {
    return step_m ? kMaxMiss_m + kMaxMissShare * step_m->norm() : kMaxFirstStep_m;
  }
  bool Resembles(const ScanObject& object) const {
    const Eigen::Vector3f size_m = object.box.sizes();
    return (size_m - this->size_m).cwiseAbs().maxCoeff() < 1.0F + 0.3F * this->size_m.maxCoeff();
  }
  void Meet(const ScanObject& object) {
    constexpr float kSmoothing = 0.4F;
    const Eigen::Vector3f step =
        (object.centroid_m - centroid_m) / static_cast<float>(num_missed + 1);
    step_m = step_m ? Eigen::Vector3f((1.0F - kSmoothing) * *step_m + kSmoothing * step) : step;
    centroid_m = object.centroid_m;
    size_m = object.box.sizes();
    num_missed = 0;
  }
};

/// The nearest object to where the track should be, or -1. Before its velocity is known a track
/// only goes on to what moves.
int FindNext(const Track& track, const std::vector<ScanObject>& objects,
             const std::vector<bool>& taken) {
  const Eigen::Vector3f predicted = track.Predicted();
  int best = -1;
  float nearest_m = track.MaxMiss();
  for (std::size_t i = 0; i < objects.size(); ++i) {
    const ScanObject& object = objects[i];
    if (taken[i] || (!object.moving && !track.step_m) ||
        static_cast<int>(object.points.size()) < kMinPointsToFollow || !track.Resembles(object)) {
      continue;
    }
    const float distance_m = (object.centroid_m - predicted).norm();
    if (distance_m >= nearest_m) continue;
    nearest_m = distance_m;
    best = static_cast<int>(i);
  }
  return best;
}

/// One scan's part of following: extends the tracks, ends those that lost their object and begins
/// new ones at moving objects that no track met.
void FollowInto(std::vector<ScanObject>* objects, std::vector<Track>* tracks) {
  std::vector<bool> taken(objects->size(), false);
  for (Track& track : *tracks) {
    const int next = FindNext(track, *objects, taken);
    if (next < 0) {
      ++track.num_missed;
      continue;
    }
    ScanObject& object = (*objects)[static_cast<std::size_t>(next)];
    taken[static_cast<std::size_t>(next)] = true;
    object.moving = true;
    track.Meet(object);
  }
  tracks->erase(std::remove_if(tracks->begin(), tracks->end(),
                               [](const Track& t) { return t.num_missed > kMaxMissed; }),
                tracks->end());
  for (std::size_t i = 0; i < objects->size(); ++i) {
    const ScanObject& object = (*objects)[i];
    if (taken[i] || !object.moving || static_cast<int>(object.points.size()) < kMinPointsToFollow) {
      continue;
    }
    Track track;
    track.centroid_m = object.centroid_m;
    track.size_m = object.box.sizes();
    tracks->push_back(track);
  }
}

}  // namespace

std::vector<ScanObject> FindScanObjects(const std::vector<LidarReturn>& points,
                                        const std::vector<PointLabel>& labels,
                                        const std::vector<PlaceKind>& kinds, int begin, int end,
                                        const MovingObjectOptions& options) {
  std::vector<int> indices;
  for (int i = begin; i < end; ++i) {
    if (labels[i] != PointLabel::kGround && kinds[i] != PlaceKind::kStatic) indices.push_back(i);
  }
  const VoxelGroups voxels = GroupByVoxel(points, indices, kObjectVoxel_m);
  const std::vector<int> object_of_voxel = ConnectVoxels(voxels);
  std::vector<ScanObject> of_voxel(voxels.size());
  for (int v = 0; v < voxels.size(); ++v) {
    ScanObject& object = of_voxel[object_of_voxel[v]];
    for (int k = voxels.begin[v]; k < voxels.begin[v + 1]; ++k) {
      const int i = voxels.order[k];
      object.points.push_back(i);
      if (kinds[i] == PlaceKind::kMoving) ++object.num_moving;
      object.box.extend(points[i].position_m);
    }
  }
  std::vector<ScanObject> objects;
  for (ScanObject& object : of_voxel) {
    if (object.points.empty() || object.box.sizes().maxCoeff() > options.max_object_extent_m) {
      continue;
    }
    std::sort(object.points.begin(), object.points.end());
    for (const int i : object.points) object.centroid_m += points[i].position_m - object.box.min();
    object.centroid_m =
        object.box.min() + object.centroid_m / static_cast<float>(object.points.size());
    object.moving = object.num_moving > 0 &&
                    object.num_moving >= options.min_moving_share * object.points.size();
    objects.push_back(std::move(object));
  }
  return objects;
}

void FollowMovingObjects(std::vector<std::vector<ScanObject>>* objects_of_scan) {
  std::vector<Track> tracks;
  for (auto& objects : *objects_of_scan) FollowInto(&objects, &tracks);
  tracks.clear();
  for (auto scan = objects_of_scan->rbegin(); scan != objects_of_scan->rend(); ++scan) {
    FollowInto(&*scan, &tracks);
  }
}

}  // namespace scenecalib
