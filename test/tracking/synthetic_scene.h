#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/rigid3.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib::testing {

/// A band-limited texture without repetition: a sum of waves of random direction and phase, exact
/// at any real position.
class Texture {
 public:
  Texture(std::uint64_t seed, double min_wavelength, double max_wavelength) {
    Random random(seed);
    for (Wave& wave : waves_) {
      const double wavelength =
          min_wavelength * std::pow(max_wavelength / min_wavelength, random.Uniform());
      const double direction = random.Uniform(0.0, 2.0 * M_PI);
      wave.x = 2.0 * M_PI / wavelength * std::cos(direction);
      wave.y = 2.0 * M_PI / wavelength * std::sin(direction);
      wave.phase = random.Uniform(0.0, 2.0 * M_PI);
    }
  }

  /// Grey value, within 20..235 almost everywhere.
  double operator()(double x, double y) const {
    double sum = 0.0;
    for (const Wave& wave : waves_) sum += std::cos(wave.x * x + wave.y * y + wave.phase);
    return 128.0 + 40.0 * sum / std::sqrt(0.5 * kNumWaves);
  }

 private:
  static constexpr int kNumWaves = 24;
  struct Wave {
    double x, y, phase;
  };
  std::array<Wave, kNumWaves> waves_;
};

inline uchar ToGrey(double value) {
  return static_cast<uchar>(std::clamp(std::lround(value), 0L, 255L));
}

/// Image whose grey value at (x, y) is given by a function, with Gaussian noise.
inline cv::Mat Render(int width_px, int height_px, const std::function<double(double, double)>& at,
                      double noise_sigma = 0.0, std::uint64_t seed = 1) {
  Random random(seed);
  cv::Mat image(height_px, width_px, CV_8UC1);
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px; ++x) {
      const double noise = noise_sigma > 0.0 ? noise_sigma * random.Gaussian() : 0.0;
      image.at<uchar>(y, x) = ToGrey(at(x, y) + noise);
    }
  }
  return image;
}

/// A textured plane in the map: texture coordinates are metres along `u` and `v`.
struct TexturedPlane {
  Eigen::Vector3d origin_in_map_m;
  Eigen::Vector3d u;  ///< unit
  Eigen::Vector3d v;  ///< unit, orthogonal to u
  Texture texture;

  Eigen::Vector3d normal() const { return u.cross(v); }

  /// Range along a unit ray from a point; none when the ray does not meet the plane in front.
  std::optional<double> Meet(const Eigen::Vector3d& from_in_map_m,
                             const Eigen::Vector3d& ray_in_map) const {
    const double range = normal().dot(origin_in_map_m - from_in_map_m) / normal().dot(ray_in_map);
    if (!(range > 0.05)) return std::nullopt;
    return range;
  }
};

/// The nearest of the planes along the ray through a pixel.
struct PlaneHit {
  int plane = -1;
  Eigen::Vector3d point_in_map_m;
};

inline std::optional<PlaneHit> HitPlanes(const std::vector<TexturedPlane>& planes,
                                         const CameraModel& model, const Rigid3& map_from_camera,
                                         const Eigen::Vector2d& pixel) {
  const auto ray = model.Unproject(pixel);
  if (!ray) return std::nullopt;
  const Eigen::Vector3d ray_in_map = map_from_camera.rotation * *ray;
  std::optional<PlaneHit> hit;
  double nearest = 1e9;
  for (int i = 0; i < static_cast<int>(planes.size()); ++i) {
    const auto range = planes[i].Meet(map_from_camera.translation, ray_in_map);
    if (!range || *range >= nearest) continue;
    nearest = *range;
    hit = PlaneHit{i, map_from_camera.translation + *range * ray_in_map};
  }
  return hit;
}

/// What the camera sees of the planes; grey 90 elsewhere, black outside the model's domain.
inline cv::Mat RenderPlanes(const std::vector<TexturedPlane>& planes, const CameraModel& model,
                            const Rigid3& map_from_camera, double noise_sigma = 0.0,
                            std::uint64_t seed = 1) {
  return Render(
      model.width_px(), model.height_px(),
      [&](double x, double y) {
        if (!model.Unproject({x, y})) return 0.0;
        const auto hit = HitPlanes(planes, model, map_from_camera, {x, y});
        if (!hit) return 90.0;
        const TexturedPlane& plane = planes[hit->plane];
        const Eigen::Vector3d offset = hit->point_in_map_m - plane.origin_in_map_m;
        return plane.texture(offset.dot(plane.u), offset.dot(plane.v));
      },
      noise_sigma, seed);
}

inline CameraModelPtr MakePinhole(int width_px, int height_px, double focal_px) {
  CameraIntrinsics intrinsics;
  intrinsics.model = "plumb_bob";
  intrinsics.width_px = width_px;
  intrinsics.height_px = height_px;
  intrinsics.focal_px = {focal_px, focal_px};
  intrinsics.principal_point_px = {0.5 * (width_px - 1), 0.5 * (height_px - 1)};
  intrinsics.distortion = {-0.05, 0.01, 0.0, 0.0, 0.0};
  return CreateCameraModel(intrinsics).value();
}

inline CameraModelPtr MakeFisheye(int width_px, int height_px, double focal_px) {
  CameraIntrinsics intrinsics;
  intrinsics.model = "ftheta";
  intrinsics.width_px = width_px;
  intrinsics.height_px = height_px;
  intrinsics.principal_point_px = {0.5 * (width_px - 1), 0.5 * (height_px - 1)};
  intrinsics.polynomial_px = {focal_px, 0.0, -0.02 * focal_px, 0.0, 0.0};
  return CreateCameraModel(intrinsics).value();
}

}  // namespace scenecalib::testing
