#include "scenecalib/calibration/trajectory_correction.h"

#include <algorithm>
#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {

TrajectoryCorrection::TrajectoryCorrection(Timestamp start_ns, Timestamp end_ns,
                                           double knot_spacing_s)
    : start_ns_(start_ns), knot_spacing_s_(knot_spacing_s) {
  const double duration_s = std::max(0.0, SecondsBetween(start_ns, end_ns));
  const auto count = static_cast<std::size_t>(std::ceil(duration_s / knot_spacing_s)) + 1;
  knots_.assign(std::max<std::size_t>(2, count), Vector6d::Zero());
}

TrajectoryCorrection::Place TrajectoryCorrection::Locate(Timestamp stamp_ns) const {
  const double last = static_cast<double>(knots_.size()) - 1.0;
  const double position =
      std::clamp(SecondsBetween(start_ns_, stamp_ns) / knot_spacing_s_, 0.0, last);
  Place place;
  place.index = static_cast<int>(std::min(std::floor(position), last - 1.0));
  place.fraction = position - place.index;
  return place;
}

Vector6d TrajectoryCorrection::At(const Place& place) const {
  if (knots_.empty()) return Vector6d::Zero();
  return (1.0 - place.fraction) * knots_[place.index] + place.fraction * knots_[place.index + 1];
}

Rigid3 TrajectoryCorrection::Apply(const Rigid3& map_from_lidar, Timestamp stamp_ns) const {
  if (knots_.empty()) return map_from_lidar;
  return ApplyCorrection(map_from_lidar, At(stamp_ns));
}

Rigid3 ApplyCorrection(const Rigid3& map_from_lidar, const Vector6d& correction) {
  return map_from_lidar * Rigid3(ExpSo3(correction.head<3>()), correction.tail<3>());
}

}  // namespace scenecalib
