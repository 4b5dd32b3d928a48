#include "bench/point_labels.h"

#include "src/mapping/ground_segmentation.h"
#include "src/mapping/moving_objects.h"

namespace scenecalib {

std::vector<std::vector<ReturnFate>> LabelReturns(const std::vector<RegisteredScan>& scans,
                                                  const SurfaceOptions& options) {
  const std::vector<LidarReturn> points = CollectReturns(scans, options.min_range_m);
  std::vector<PointLabel> labels(points.size(), PointLabel::kStructure);
  SegmentGround(points, options.ground, &labels);
  RemoveMovingObjects(points, options.moving_objects, &labels);
  std::vector<std::vector<ReturnFate>> fates(scans.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    fates[points[i].scan].push_back(labels[i] == PointLabel::kMoving   ? ReturnFate::kMoving
                                    : labels[i] == PointLabel::kGround ? ReturnFate::kGround
                                                                       : ReturnFate::kStructure);
  }
  return fates;
}

}  // namespace scenecalib
