// An image is made in three passes, each parallel over tiles or rows that share nothing: one sample
// per pixel; more samples for pixels whose right or lower neighbours show another object, another
// side of it, or the other side of a shadow's edge; exposure, response and noise.

#include "scenecalib/simulation/camera_renderer.h"

#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

#include "scenecalib/simulation/noise.h"

namespace scenecalib {

namespace {

constexpr int kTileWidth = 32;
constexpr int kTileHeight = 8;
constexpr std::uint32_t kSky = 0xffffffffU;
constexpr std::size_t kResponseSteps = 2048;
constexpr std::size_t kNoiseSteps = 1024;

/// Light of the sky in a direction: brighter near the horizon, with faint clouds.
Eigen::Vector3f SkyLight(const Eigen::Vector3f& direction) {
  const float up = std::max(direction.z(), 0.02F);
  const float x = direction.x() / (up + 0.3F);
  const float y = direction.y() / (up + 0.3F);
  const float cloud = 0.5F + 0.35F * ValueNoise(1.5F * x, 1.5F * y, 77U) +
                      0.15F * ValueNoise(4.0F * x, 4.0F * y, 78U);
  const Eigen::Vector3f blue(1.15F, 0.95F, 0.75F);
  const Eigen::Vector3f white(1.25F, 1.25F, 1.25F);
  const float share = std::min(std::max(cloud, 0.0F), 1.0F) * 0.6F + 0.3F * (1.0F - up);
  return blue + share * (white - blue);
}

float Median(std::vector<float> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

}  // namespace

/// One ray and what it brought.
struct CameraRenderer::Sample {
  Eigen::Vector3f direction_in_map = Eigen::Vector3f::Zero();
  Eigen::Vector3f ray_dx = Eigen::Vector3f::Zero();
  Eigen::Vector3f ray_dy = Eigen::Vector3f::Zero();
  Eigen::Vector3f light = Eigen::Vector3f::Zero();
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();
  std::uint32_t surface = kSky;  ///< surface's and object's identity
  float range_m = 0.0F;
  bool lit = false;
};

/// What a pixel shows, as far as edges need it.
struct PixelKey {
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();
  std::uint32_t surface = kSky;
  float range_m = 0.0F;
  bool lit = false;

  bool SameAs(const PixelKey& other) const {
    if (surface != other.surface || lit != other.lit) return false;
    if (surface == kSky) return true;
    return normal.dot(other.normal) > 0.97F &&
           std::abs(range_m - other.range_m) < 0.4F * std::min(range_m, other.range_m);
  }
};

struct CameraRenderer::Frame {
  RenderView view;
  std::vector<Eigen::Vector3f> light;
  std::vector<PixelKey> keys;
};

/// Rows of a tile that are exposed together.
struct CameraRenderer::Band {
  const RenderInstant* instant;
  bool sees_own;
  int first_x, last_x;  ///< the last one not included
  int first_y, last_y;
};

CameraRenderer::CameraRenderer(const SceneTracer* tracer, CameraModelPtr model,
                               const SimulatedCameraOptions& options, const Sunlight& sunlight,
                               const Rigid3& camera_from_own_vehicle, bool sees_own_vehicle,
                               Random random)
    : tracer_(tracer),
      options_(options),
      sunlight_(sunlight),
      sees_own_vehicle_(sees_own_vehicle),
      width_(model->width_px()),
      height_(model->height_px()),
      tiles_x_((width_ + kTileWidth - 1) / kTileWidth),
      tiles_y_((height_ + kTileHeight - 1) / kTileHeight) {
  const double exposure = 1.5 * std::exp(options.exposure_spread * random.Uniform(-1.0, 1.0));
  const double gamma = random.Uniform(1.9, 2.4);
  const double vignetting = random.Uniform(0.15, 0.4);
  const double max_theta_rad = options.max_theta_deg * M_PI / 180.0;
  const double corner_px = 0.5 * std::hypot(width_, height_);
  rays_.assign(Index(0, height_), Eigen::Vector3f::Zero());
  gain_.assign(rays_.size(), 0.0F);
  tbb::parallel_for(0, height_, [&](int y) {
    for (int x = 0; x < width_; ++x) {
      const auto ray = model->Unproject({static_cast<double>(x), static_cast<double>(y)});
      if (!ray || std::atan2(ray->head<2>().norm(), ray->z()) > max_theta_rad) continue;
      rays_[Index(x, y)] = ray->cast<float>();
      const double radius =
          (Eigen::Vector2d(x, y) - model->tunable().principal_point_px).norm() / corner_px;
      gain_[Index(x, y)] = static_cast<float>(exposure * (1.0 - vignetting * radius * radius));
    }
  });
  for (std::size_t i = 0; i <= kResponseSteps; ++i) {
    const double share = static_cast<double>(i) / static_cast<double>(kResponseSteps);
    response_.push_back(static_cast<float>(255.0 * std::pow(share, 1.0 / gamma)));
  }
  for (std::size_t i = 0; i < kNoiseSteps; ++i) {
    noise_levels_.push_back(static_cast<float>(options.noise_levels * random.Gaussian()));
  }
  // Drawn numbers have a mean of their own; a camera's offset is not noise.
  const float middle = Median(noise_levels_);
  for (float& level : noise_levels_) level -= middle;
  FindOwnVehicle(camera_from_own_vehicle);
}

/// Marks the tiles in which the own body can be seen: it does not move in the image.
void CameraRenderer::FindOwnVehicle(const Rigid3& camera_from_own_vehicle) {
  tile_sees_own_.assign(static_cast<std::size_t>(tiles_x_ * tiles_y_), 0);
  if (!sees_own_vehicle_) return;
  const std::vector<Rigid3> poses(static_cast<std::size_t>(tracer_->num_objects()),
                                  Rigid3(Eigen::Quaterniond::Identity(), {0.0, 0.0, 1e6}));
  std::vector<Rigid3> in_camera = poses;
  in_camera.back() = camera_from_own_vehicle;
  TraceOptions options;
  options.num_objects = tracer_->num_objects();
  // Far from the world, whose rays would hide the body's: the camera's own frame, moved up.
  const Eigen::Vector3d away(0.0, 0.0, 1e5);
  in_camera.back().translation += away;
  tbb::parallel_for(0, height_, [&](int y) {
    std::vector<SceneHit> hits(static_cast<std::size_t>(width_));
    tracer_->Trace(away, &rays_[Index(0, y)], hits.size(), in_camera, options, hits.data());
    for (int x = 0; x < width_; ++x) {
      if (hits[static_cast<std::size_t>(x)].object != tracer_->num_objects()) continue;
      // One pixel more on each side, for the samples on edges.
      for (const int tx : {(x - 1) / kTileWidth, (x + 1) / kTileWidth}) {
        for (const int ty : {(y - 1) / kTileHeight, (y + 1) / kTileHeight}) {
          if (tx >= tiles_x_ || ty >= tiles_y_) continue;
          tile_sees_own_[static_cast<std::size_t>(ty * tiles_x_ + tx)] = 1;
        }
      }
    }
  });
}

/// Change of the ray from one pixel to the next along an axis.
Eigen::Vector3f CameraRenderer::RayStep(int x, int y, int step_x, int step_y) const {
  const Eigen::Vector3f& here = rays_[Index(x, y)];
  if (x + step_x < width_ && y + step_y < height_ && IsLit(x + step_x, y + step_y)) {
    return rays_[Index(x + step_x, y + step_y)] - here;
  }
  if (x >= step_x && y >= step_y && IsLit(x - step_x, y - step_y)) {
    return here - rays_[Index(x - step_x, y - step_y)];
  }
  return Eigen::Vector3f::Zero();
}

std::vector<CameraRenderer::Band> CameraRenderer::BandsOf(int tile, const Frame& frame) const {
  const auto& instants = frame.view.instants;
  const int x = (tile % tiles_x_) * kTileWidth;
  const int y = (tile / tiles_x_) * kTileHeight;
  Band band{&instants.front(),
            tile_sees_own_[static_cast<std::size_t>(tile)] != 0,
            x,
            std::min(x + kTileWidth, width_),
            y,
            std::min(y + kTileHeight, height_)};
  if (instants.size() == 1) return {band};
  std::vector<Band> rows;
  for (int row = band.first_y; row < std::min(y + kTileHeight, height_); ++row) {
    band.instant = &instants[static_cast<std::size_t>(row)];
    band.first_y = row;
    band.last_y = row + 1;
    rows.push_back(band);
  }
  return rows;
}

void CameraRenderer::Shade(const RenderInstant& instant, Sample* samples, std::size_t num_samples,
                           bool own_vehicle) const {
  thread_local std::vector<Eigen::Vector3f> directions, points;
  thread_local std::vector<SceneHit> hits;
  directions.resize(num_samples);
  hits.resize(num_samples);
  for (std::size_t i = 0; i < num_samples; ++i) directions[i] = samples[i].direction_in_map;
  TraceOptions trace;
  trace.coherent = true;
  trace.num_objects = tracer_->num_objects() - (own_vehicle ? 0 : 1);
  const Eigen::Vector3d& origin = instant.map_from_camera.translation;
  const auto& poses = instant.map_from_object;
  tracer_->Trace(origin, directions.data(), num_samples, poses, trace, hits.data());

  // Which of the points that face the sun does it reach?
  thread_local std::vector<std::size_t> facing;
  facing.clear();
  points.clear();
  const Eigen::Vector3f float_origin = origin.cast<float>();
  for (std::size_t i = 0; i < num_samples; ++i) {
    const SceneHit& hit = hits[i];
    if (hit.object == SceneHit::kNone) continue;
    samples[i].normal = hit.normal_in_map;
    samples[i].range_m = hit.range_m;
    if (hit.normal_in_map.dot(sunlight_.towards_sun) <= 0.0F) continue;
    samples[i].lit = true;
    if (!sunlight_.shadows || tracer_->SurfaceOf(hit).material == Material::kLeaves) continue;
    facing.push_back(i);
    points.emplace_back(float_origin + hit.range_m * directions[i] + 1e-3F * hit.normal_in_map);
  }
  if (!points.empty()) {
    const std::unique_ptr<bool[]> lit(new bool[points.size()]);
    tracer_->TraceSun(points.data(), points.size(), sunlight_.towards_sun, poses, lit.get());
    for (std::size_t i = 0; i < points.size(); ++i) samples[facing[i]].lit = lit[i];
  }
  for (std::size_t i = 0; i < num_samples; ++i) {
    Sample& sample = samples[i];
    const SceneHit& hit = hits[i];
    if (hit.object == SceneHit::kNone) {
      sample.light = SkyLight(directions[i]);
      continue;
    }
    const Surface& surface = tracer_->SurfaceOf(hit);
    sample.surface =
        HashLattice(static_cast<std::int32_t>(surface.seed), hit.object, surface.object_id) &
        0x7fffffffU;
    const Eigen::Vector3f albedo =
        tracer_->Albedo(hit, directions[i], sample.ray_dx, sample.ray_dy, poses);
    const float sky = 0.36F + 0.14F * hit.normal_in_map.z();
    const float sun = sample.lit ? 0.85F * hit.normal_in_map.dot(sunlight_.towards_sun) : 0.0F;
    sample.light = albedo.cwiseProduct(sky * Eigen::Vector3f(1.12F, 1.0F, 0.9F) +
                                       sun * Eigen::Vector3f(0.9F, 0.98F, 1.05F));
  }
}

void CameraRenderer::RenderBand(const Band& band, Frame* frame) const {
  const Eigen::Matrix3f rotation = band.instant->map_from_camera.RotationMatrix().cast<float>();
  std::vector<Sample> samples;
  std::vector<std::size_t> pixels;
  samples.reserve(kTileWidth * kTileHeight);
  pixels.reserve(kTileWidth * kTileHeight);
  for (int y = band.first_y; y < band.last_y; ++y) {
    for (int x = band.first_x; x < band.last_x; ++x) {
      if (!IsLit(x, y)) continue;
      Sample sample;
      sample.direction_in_map = rotation * rays_[Index(x, y)];
      sample.ray_dx = rotation * RayStep(x, y, 1, 0);
      sample.ray_dy = rotation * RayStep(x, y, 0, 1);
      samples.push_back(sample);
      pixels.push_back(Index(x, y));
    }
  }
  if (samples.empty()) return;
  Shade(*band.instant, samples.data(), samples.size(), band.sees_own);
  for (std::size_t i = 0; i < samples.size(); ++i) {
    frame->light[pixels[i]] = samples[i].light;
    PixelKey& key = frame->keys[pixels[i]];
    key.normal = samples[i].normal;
    key.surface = samples[i].surface;
    key.range_m = samples[i].range_m;
    key.lit = samples[i].lit;
  }
}

void CameraRenderer::SmoothBand(const Band& band, Frame* frame) const {
  const Eigen::Matrix3f rotation = band.instant->map_from_camera.RotationMatrix().cast<float>();
  const auto differs = [&](int x, int y, int nx, int ny) {
    if (nx < 0 || ny < 0 || nx >= width_ || ny >= height_ || !IsLit(nx, ny)) return false;
    return !frame->keys[Index(x, y)].SameAs(frame->keys[Index(nx, ny)]);
  };
  const int n = options_.supersampling;
  std::vector<Sample> samples;
  std::vector<std::size_t> pixels;
  for (int y = band.first_y; y < band.last_y; ++y) {
    for (int x = band.first_x; x < band.last_x; ++x) {
      if (!IsLit(x, y) || !(differs(x, y, x + 1, y) || differs(x, y, x - 1, y) ||
                            differs(x, y, x, y + 1) || differs(x, y, x, y - 1))) {
        continue;
      }
      Sample sample;
      sample.ray_dx = RayStep(x, y, 1, 0);
      sample.ray_dy = RayStep(x, y, 0, 1);
      // A lattice of rank one: no two samples share a row or a column.
      for (int k = 0; k < n; ++k) {
        const float along = (static_cast<float>(k) + 0.5F) / static_cast<float>(n) - 0.5F;
        const float golden = 0.618034F * static_cast<float>(k) + 0.309F;
        const float across = golden - std::floor(golden) - 0.5F;
        Sample one = sample;
        one.direction_in_map =
            rotation *
            (rays_[Index(x, y)] + along * sample.ray_dx + across * sample.ray_dy).normalized();
        one.ray_dx = rotation * sample.ray_dx;
        one.ray_dy = rotation * sample.ray_dy;
        samples.push_back(one);
      }
      pixels.push_back(Index(x, y));
    }
  }
  if (samples.empty()) return;
  Shade(*band.instant, samples.data(), samples.size(), band.sees_own);
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    // Averaged after the response's compression would be wrong: light adds up before the sensor.
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    for (int k = 0; k < n; ++k)
      sum += samples[i * static_cast<std::size_t>(n) + static_cast<std::size_t>(k)].light;
    frame->light[pixels[i]] = sum / static_cast<float>(n);
  }
}

void CameraRenderer::DevelopRow(int y, const Frame& frame, cv::Mat* image) const {
  const int channels = image->channels();
  auto* row = image->ptr<std::uint8_t>(y);
  const auto develop = [&](float light, std::uint32_t noise) {
    const float compressed = (1.0F - std::exp(-light)) * static_cast<float>(kResponseSteps);
    const auto step =
        std::min(static_cast<std::size_t>(std::max(compressed, 0.0F)), kResponseSteps - 1);
    const float rest = compressed - static_cast<float>(step);
    const float level = response_[step] + rest * (response_[step + 1] - response_[step]) +
                        noise_levels_[noise & (kNoiseSteps - 1)];
    return static_cast<std::uint8_t>(std::min(std::max(level + 0.5F, 0.0F), 255.0F));
  };
  for (int x = 0; x < width_; ++x) {
    const float gain = gain_[Index(x, y)] * frame.view.exposure;
    const Eigen::Vector3f light = gain * frame.light[Index(x, y)];
    const std::uint32_t noise = HashLattice(x, y, frame.view.noise_seed);
    if (channels == 1) {
      const float grey = 0.114F * light[0] + 0.587F * light[1] + 0.299F * light[2];
      row[x] = develop(grey, noise);
    } else {
      for (int c = 0; c < 3; ++c) row[3 * x + c] = develop(light[c], noise >> (10 * c));
    }
  }
}

cv::Mat CameraRenderer::Render(const RenderView& view) const {
  Frame frame;
  frame.view = view;
  frame.light.assign(rays_.size(), Eigen::Vector3f::Zero());
  frame.keys.resize(rays_.size());
  cv::Mat image(height_, width_, options_.color ? CV_8UC3 : CV_8UC1);
  tbb::parallel_for(0, tiles_x_ * tiles_y_, [&](int tile) {
    for (const Band& band : BandsOf(tile, frame)) RenderBand(band, &frame);
  });
  if (options_.supersampling > 1) {
    tbb::parallel_for(0, tiles_x_ * tiles_y_, [&](int tile) {
      for (const Band& band : BandsOf(tile, frame)) SmoothBand(band, &frame);
    });
  }
  tbb::parallel_for(0, height_, [&](int y) { DevelopRow(y, frame, &image); });
  return image;
}

}  // namespace scenecalib
