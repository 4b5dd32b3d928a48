#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "lidar_return.h"

namespace scenecalib {

/// What a scan says about a place.
enum class Visibility { kUnknown, kOccupied, kFree };

/// One scan as ranges over direction, to ask whether it saw through a place. Every return is seen
/// from where the sensor was at its own time, which matters: it moves by a metre in a sweep.
class RangeImage {
 public:
  /// Of points[begin, end), which must be one scan's.
  RangeImage(const std::vector<LidarReturn>& points, const std::vector<PointLabel>& labels,
             int begin, int end);

  /// Free when every return around the direction of the place, but nearer ground, ends more than
  /// margin_m behind it; occupied when one ends at it.
  Visibility Test(const Eigen::Vector3f& place_m, float radius_m, float margin_m,
                  float max_range_m) const;

 private:
  /// Centimetres: hundreds of images are held at a time.
  struct Pixel {
    std::uint16_t nearest_cm;          ///< nearest structure; kNone when none
    std::uint16_t farthest_ground_cm;  ///< farthest ground; 0 when none
  };
  static constexpr std::uint16_t kNone = 65535;
  static int AzimuthBin(const Eigen::Vector3f& direction);
  void FillOrigins(const std::vector<LidarReturn>& points, int begin, int end);

  std::vector<Pixel> pixels_;
  std::vector<Eigen::Vector3f> origins_m_;  ///< sensor position by azimuth bin
  Eigen::Vector3f mean_origin_m_ = Eigen::Vector3f::Zero();
};

}  // namespace scenecalib
