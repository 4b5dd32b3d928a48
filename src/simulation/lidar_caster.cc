#include "scenecalib/simulation/lidar_caster.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "scenecalib/base/random.h"

namespace scenecalib {

namespace {

constexpr float kDarkAlbedo = 0.1F;      // darker surfaces swallow some of the light
constexpr float kGrazingCosine = 0.08F;  // flatter rays are mirrored away

/// Chance that a return is too weak to be detected.
double LossProbability(double cosine, double albedo, Material material, double dropout) {
  double detected = 1.0 - dropout;
  if (cosine < kGrazingCosine) detected *= cosine / kGrazingCosine;
  if (albedo < kDarkAlbedo) detected *= 0.6 + 0.4 * albedo / kDarkAlbedo;
  // Most of the light goes through a pane, or is mirrored.
  if (material == Material::kDarkGlass || material == Material::kWindow) detected *= 0.5;
  return 1.0 - detected;
}

}  // namespace

LidarScan CastLidarScan(const SceneTracer& tracer, const SimulatedLidarOptions& options,
                        bool sees_own_vehicle, Timestamp start_ns, std::uint64_t noise_seed,
                        const std::function<SceneInstant(Timestamp)>& instant_at) {
  const auto rings = static_cast<std::size_t>(options.rings);
  const auto columns = static_cast<std::size_t>(options.columns);
  const double column_step_s = 1.0 / (options.rate_hz * options.columns);
  const double low_rad = options.lowest_ring_deg * M_PI / 180.0;
  const double ring_step_rad = (options.highest_ring_deg - options.lowest_ring_deg) * M_PI / 180.0 /
                               static_cast<double>(rings - 1);
  TraceOptions trace;
  trace.max_range_m = static_cast<float>(options.max_range_m);
  trace.num_objects = tracer.num_objects() - (sees_own_vehicle ? 0 : 1);
  // The laser's spot, for the intensity: two milliradians.
  const float spot_rad = 2e-3F;

  std::vector<std::vector<LidarPoint>> points_of_column(columns);
  tbb::parallel_for(std::size_t{0}, columns, [&](std::size_t column) {
    const double offset_s = static_cast<double>(column) * column_step_s;
    const SceneInstant instant = instant_at(AddSeconds(start_ns, offset_s));
    const Eigen::Matrix3d rotation = instant.map_from_lidar.RotationMatrix();
    const double azimuth_rad =
        M_PI - 2.0 * M_PI * static_cast<double>(column) / static_cast<double>(columns);
    std::vector<Eigen::Vector3d> directions(rings);
    std::vector<Eigen::Vector3f> directions_in_map(rings);
    for (std::size_t ring = 0; ring < rings; ++ring) {
      const double elevation_rad = low_rad + static_cast<double>(ring) * ring_step_rad;
      directions[ring] = {std::cos(elevation_rad) * std::cos(azimuth_rad),
                          std::cos(elevation_rad) * std::sin(azimuth_rad), std::sin(elevation_rad)};
      directions_in_map[ring] = (rotation * directions[ring]).cast<float>();
    }
    std::vector<SceneHit> hits(rings);
    tracer.Trace(instant.map_from_lidar.translation, directions_in_map.data(), rings,
                 instant.map_from_object, trace, hits.data());
    Random random = Random(noise_seed).Fork(column);
    for (std::size_t ring = 0; ring < rings; ++ring) {
      // Drawn for every ray, so that noise does not depend on what other rays meet.
      const double noise_m = options.range_noise_m * random.Gaussian();
      const double chance = random.Uniform();
      const SceneHit& hit = hits[ring];
      if (hit.object == SceneHit::kNone) continue;
      const Eigen::Vector3f& direction = directions_in_map[ring];
      const Eigen::Vector3f across = spot_rad * direction.unitOrthogonal();
      const float albedo =
          tracer.Albedo(hit, direction, across, direction.cross(across), instant.map_from_object)
              .mean();
      const float cosine = -hit.normal_in_map.dot(direction);
      if (chance <
          LossProbability(cosine, albedo, tracer.SurfaceOf(hit).material, options.dropout)) {
        continue;
      }
      const double range_m = hit.range_m + noise_m;
      if (range_m < options.min_range_m || range_m > options.max_range_m) continue;
      LidarPoint point;
      point.position_in_lidar_m = (range_m * directions[ring]).cast<float>();
      point.time_offset_s = static_cast<float>(offset_s);
      point.intensity = std::min(255.0F, 255.0F * albedo * (0.4F + 0.6F * cosine));
      point.ring = static_cast<std::uint16_t>(ring);
      points_of_column[column].push_back(point);
    }
  });
  LidarScan scan;
  scan.stamp_ns = start_ns;
  for (const auto& points : points_of_column) {
    scan.points.insert(scan.points.end(), points.begin(), points.end());
  }
  return scan;
}

}  // namespace scenecalib
