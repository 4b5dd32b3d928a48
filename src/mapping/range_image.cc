#include "range_image.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace scenecalib {
namespace {

/// Half a degree per pixel: about the spacing of a 64-ring sensor's rings.
constexpr int kNumAzimuths = 720;
constexpr int kNumElevations = 240;  // -60 to 60 degrees
constexpr float kPixel_rad = 2.0F * static_cast<float>(M_PI) / kNumAzimuths;
constexpr float kInfinity = std::numeric_limits<float>::infinity();
/// Near a place, more pixels than this tell nothing new.
constexpr int kMaxWindow = 6;

int ElevationBin(const Eigen::Vector3f& direction, float range_m) {
  return static_cast<int>(std::floor(std::asin(direction.z() / range_m) / kPixel_rad)) +
         kNumElevations / 2;
}

}  // namespace

int RangeImage::AzimuthBin(const Eigen::Vector3f& direction) {
  const float turns = std::atan2(direction.y(), direction.x()) / kPixel_rad;
  const int bin = static_cast<int>(std::floor(turns));
  return (bin % kNumAzimuths + kNumAzimuths) % kNumAzimuths;
}

RangeImage::RangeImage(const std::vector<ScenePoint>& points, const std::vector<PointLabel>& labels,
                       int begin, int end)
    : pixels_(kNumAzimuths * kNumElevations, Pixel{kInfinity, 0.0F}) {
  for (int i = begin; i < end; ++i) {
    const Eigen::Vector3f direction = points[i].position_m - points[i].origin_m;
    const float range_m = direction.norm();
    const int elevation = ElevationBin(direction, range_m);
    if (elevation < 0 || elevation >= kNumElevations) continue;
    Pixel& pixel = pixels_[elevation * kNumAzimuths + AzimuthBin(direction)];
    if (labels[i] == PointLabel::kGround) {
      pixel.farthest_ground_m = std::max(pixel.farthest_ground_m, range_m);
    } else {
      pixel.nearest_m = std::min(pixel.nearest_m, range_m);
    }
  }
  FillOrigins(points, begin, end);
}

void RangeImage::FillOrigins(const std::vector<ScenePoint>& points, int begin, int end) {
  origins_m_.assign(kNumAzimuths, Eigen::Vector3f::Zero());
  std::vector<int> counts(kNumAzimuths, 0);
  for (int i = begin; i < end; ++i) {
    const int bin = AzimuthBin(points[i].position_m - points[i].origin_m);
    // The first return of a bin stands for it: the seam of the sweep must not average two ends.
    if (counts[bin]++ == 0) origins_m_[bin] = points[i].origin_m;
    mean_origin_m_ += points[i].origin_m;
  }
  mean_origin_m_ /= static_cast<float>(std::max(1, end - begin));
  for (int bin = 0; bin < kNumAzimuths; ++bin) {
    if (counts[bin] == 0) origins_m_[bin] = mean_origin_m_;
  }
}

Visibility RangeImage::Test(const Eigen::Vector3f& place_m, float radius_m, float margin_m,
                            float max_range_m) const {
  Eigen::Vector3f direction = place_m - mean_origin_m_;
  direction = place_m - origins_m_[AzimuthBin(direction)];
  const float range_m = direction.norm();
  if (range_m > max_range_m || range_m < 4.0F * radius_m) return Visibility::kUnknown;
  const int azimuth = AzimuthBin(direction);
  const int elevation = ElevationBin(direction, range_m);
  const int half =
      std::clamp(static_cast<int>(std::ceil(radius_m / range_m / kPixel_rad)), 1, kMaxWindow);
  if (elevation < half || elevation >= kNumElevations - half) return Visibility::kUnknown;
  const float behind_m = range_m + margin_m;
  bool seen_beyond = false;
  bool occupied = false;
  bool occluded = false;
  for (int de = -half; de <= half; ++de) {
    for (int da = -half; da <= half; ++da) {
      const int column = (azimuth + da + kNumAzimuths) % kNumAzimuths;
      const Pixel& pixel = pixels_[(elevation + de) * kNumAzimuths + column];
      if (pixel.farthest_ground_m > behind_m) seen_beyond = true;
      if (pixel.nearest_m == kInfinity) continue;
      if (pixel.nearest_m > behind_m) {
        seen_beyond = true;
      } else if (pixel.nearest_m > range_m - margin_m) {
        occupied = true;
      } else {
        occluded = true;
      }
    }
  }
  if (occupied) return Visibility::kOccupied;
  if (occluded || !seen_beyond) return Visibility::kUnknown;
  return Visibility::kFree;
}

}  // namespace scenecalib
