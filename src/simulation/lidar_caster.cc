#include "scenecalib/simulation/lidar_caster.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace scenecalib {

namespace {

constexpr float kDarkAlbedo = 0.1F;      // darker surfaces swallow some of the light
constexpr float kGrazingCosine = 0.08F;  // flatter rays are mirrored away
// Echoes nearer to each other than a pulse is long are measured as one.
constexpr double kPulseM = 0.6;

/// Chance that a return is too weak to be detected.
double LossProbability(double cosine, double albedo, Material material, double dropout) {
  double detected = 1.0 - dropout;
  if (cosine < kGrazingCosine) detected *= cosine / kGrazingCosine;
  if (albedo < kDarkAlbedo) detected *= 0.6 + 0.4 * albedo / kDarkAlbedo;
  // Most of the light goes through a pane, or is mirrored.
  if (material == Material::kDarkGlass || material == Material::kWindow) detected *= 0.5;
  return 1.0 - detected;
}

Eigen::Vector3d Direction(double azimuth_rad, double elevation_rad) {
  return {std::cos(elevation_rad) * std::cos(azimuth_rad),
          std::cos(elevation_rad) * std::sin(azimuth_rad), std::sin(elevation_rad)};
}

/// A direction within the beam around `direction`, uniform over its disc.
Eigen::Vector3f WithinBeam(const Eigen::Vector3f& direction, double beam_rad, Random* random) {
  const double radius = 0.5 * beam_rad * std::sqrt(random->Uniform());
  const double angle = 2.0 * M_PI * random->Uniform();
  const Eigen::Vector3f across = direction.unitOrthogonal();
  return (direction + static_cast<float>(radius * std::cos(angle)) * across +
          static_cast<float>(radius * std::sin(angle)) * direction.cross(across))
      .normalized();
}

/// What is measured of a beam that meets two things: one range between them where their echoes run
/// into each other, otherwise that of the one that more of the beam meets.
double MixedRange(double range_m, const SceneHit& other, double share_of_other) {
  if (other.object == SceneHit::kNone) return range_m;
  if (std::abs(other.range_m - range_m) > kPulseM) {
    return share_of_other > 0.5 ? other.range_m : range_m;
  }
  return range_m + share_of_other * (other.range_m - range_m);
}

}  // namespace

std::vector<Laser> MakeLasers(const SimulatedLidarOptions& options, Random random) {
  constexpr double kRadians = M_PI / 180.0;
  const double step_deg =
      (options.highest_ring_deg - options.lowest_ring_deg) / (options.rings - 1.0);
  std::vector<Laser> lasers(static_cast<std::size_t>(options.rings));
  for (std::size_t ring = 0; ring < lasers.size(); ++ring) {
    Laser& laser = lasers[ring];
    laser.elevation_rad =
        kRadians * options.lowest_ring_deg + static_cast<double>(ring) * kRadians * step_deg;
    laser.elevation_error_rad = kRadians * options.ring_angle_deg * random.Gaussian();
    laser.azimuth_error_rad = kRadians * options.ring_angle_deg * random.Gaussian();
    laser.range_error_m = options.ring_range_m * random.Gaussian();
  }
  return lasers;
}

LidarScan CastLidarScan(const SceneTracer& tracer, const SimulatedLidarOptions& options,
                        const std::vector<Laser>& lasers, bool sees_own_vehicle, Timestamp start_ns,
                        std::uint64_t noise_seed,
                        const std::function<SceneInstant(Timestamp)>& instant_at) {
  const std::size_t rings = lasers.size();
  const auto columns = static_cast<std::size_t>(options.columns);
  const double column_step_s = 1.0 / (options.rate_hz * options.columns);
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
    std::vector<Eigen::Vector3f> directions_in_map(rings);
    for (std::size_t ring = 0; ring < rings; ++ring) {
      const Laser& laser = lasers[ring];
      directions_in_map[ring] =
          (rotation * Direction(azimuth_rad + laser.azimuth_error_rad,
                                laser.elevation_rad + laser.elevation_error_rad))
              .cast<float>();
    }
    std::vector<SceneHit> hits(rings), beside(rings);
    const auto cast = [&](const std::vector<Eigen::Vector3f>& directions, SceneHit* met) {
      tracer.Trace(instant.map_from_lidar.translation, directions.data(), rings,
                   instant.map_from_object, trace, met);
    };
    cast(directions_in_map, hits.data());
    Random random = Random(noise_seed).Fork(column);
    Random random_in_beam = random.Fork(0);
    if (options.beam_mrad > 0.0) {
      std::vector<Eigen::Vector3f> directions_beside = directions_in_map;
      for (Eigen::Vector3f& direction : directions_beside) {
        direction = WithinBeam(direction, 1e-3 * options.beam_mrad, &random_in_beam);
      }
      cast(directions_beside, beside.data());
    }
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
      double range_m = hit.range_m;
      if (options.beam_mrad > 0.0) {
        range_m = MixedRange(range_m, beside[ring], random_in_beam.Uniform());
      }
      range_m += lasers[ring].range_error_m + noise_m;
      if (range_m < options.min_range_m || range_m > options.max_range_m) continue;
      LidarPoint point;
      point.position_in_lidar_m =
          (range_m * Direction(azimuth_rad, lasers[ring].elevation_rad)).cast<float>();
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
