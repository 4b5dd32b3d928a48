#include "range_image.h"

#include <algorithm>
#include <cmath>

namespace scenecalib {
namespace {

/// Half a degree per pixel: about the spacing of a 64-ring sensor's rings.
constexpr int kNumAzimuths = 720;
constexpr int kNumElevations = 240;  // -60 to 60 degrees
constexpr float kPixel_rad = 2.0F * static_cast<float>(M_PI) / kNumAzimuths;
/// Near a place, more pixels than this tell nothing new.
constexpr int kMaxWindow = 6;

/// The largest value is kept for "nothing".
std::uint16_t Centimetres(float range_m) {
  return static_cast<std::uint16_t>(std::min(100.0F * range_m, 65534.0F));
}

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

RangeImage::RangeImage(const std::vector<LidarReturn>& points,
                       const std::vector<PointLabel>& labels, int begin, int end)
    : pixels_(kNumAzimuths * kNumElevations, Pixel{kNone, 0}) {
  for (int i = begin; i < end; ++i) {
    const Eigen::Vector3f direction = points[i].position_m - points[i].origin_m;
    const float range_m = direction.norm();
    const int elevation = ElevationBin(direction, range_m);
    if (elevation < 0 || elevation >= kNumElevations) continue;
    Pixel& pixel = pixels_[elevation * kNumAzimuths + AzimuthBin(direction)];
    const std::uint16_t range_cm = Centimetres(range_m);
    if (labels[i] == PointLabel::kGround) {
      pixel.farthest_ground_cm = std::max(pixel.farthest_ground_cm, range_cm);
    } else {
      pixel.nearest_cm = std::min(pixel.nearest_cm, range_cm);
    }
  }
  FillOrigins(points, begin, end);
}

void RangeImage::FillOrigins(const std::vector<LidarReturn>& points, int begin, int end) {
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
  // The sensor moves by a few metres at most in a sweep; most places are out of reach.
  if (direction.norm() > max_range_m + 5.0F) return Visibility::kUnknown;
  direction = place_m - origins_m_[AzimuthBin(direction)];
  const float range_m = direction.norm();
  if (range_m > max_range_m || range_m < 4.0F * radius_m) return Visibility::kUnknown;
  const int azimuth = AzimuthBin(direction);
  const int elevation = ElevationBin(direction, range_m);
  const int half =
      std::clamp(static_cast<int>(std::ceil(radius_m / range_m / kPixel_rad)), 1, kMaxWindow);
  if (elevation < half || elevation >= kNumElevations - half) return Visibility::kUnknown;
  const std::uint16_t behind_cm = Centimetres(range_m + margin_m);
  const std::uint16_t before_cm = Centimetres(range_m - margin_m);
  bool seen_beyond = false;
  bool occupied = false;
  bool occluded = false;
  for (int de = -half; de <= half; ++de) {
    for (int da = -half; da <= half; ++da) {
      const int column = (azimuth + da + kNumAzimuths) % kNumAzimuths;
      const Pixel& pixel = pixels_[(elevation + de) * kNumAzimuths + column];
      if (pixel.farthest_ground_cm > behind_cm) seen_beyond = true;
      if (pixel.nearest_cm == kNone) continue;
      if (pixel.nearest_cm > behind_cm) {
        seen_beyond = true;
      } else if (pixel.nearest_cm > before_cm) {
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
