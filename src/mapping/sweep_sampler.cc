#include "sweep_sampler.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "scenecalib/mapping/voxel_plane_map.h"

namespace scenecalib {
namespace {

/// Fixed, so that the result does not depend on the number of threads.
constexpr std::size_t kChunkPoints = 8192;

struct Chunk {
  float first_s = std::numeric_limits<float>::max();
  float last_s = std::numeric_limits<float>::lowest();
  int num_in_range = 0;
  std::vector<std::uint64_t> keys;     ///< of the dense voxels met in this chunk
  std::vector<std::uint32_t> indices;  ///< of the first return in each, into the scan
};

Chunk SampleChunk(const std::vector<LidarPoint>& points, std::size_t begin, std::size_t end,
                  const SweepSampling& sampling) {
  Chunk chunk;
  VoxelIndex seen(end - begin);
  const auto min_squared = static_cast<float>(sampling.min_range_m * sampling.min_range_m);
  const auto max_squared = static_cast<float>(sampling.max_range_m * sampling.max_range_m);
  const double voxels_per_m = 1.0 / sampling.dense_voxel_m;
  for (std::size_t i = begin; i < end; ++i) {
    const LidarPoint& point = points[i];
    if (!std::isfinite(point.time_offset_s)) continue;
    chunk.first_s = std::min(chunk.first_s, point.time_offset_s);
    chunk.last_s = std::max(chunk.last_s, point.time_offset_s);
    const float squared = point.position_in_lidar_m.squaredNorm();
    // The negated form also drops a range that is not a number.
    if (!(squared >= min_squared && squared <= max_squared)) continue;
    ++chunk.num_in_range;
    const std::uint64_t key =
        VoxelKey::OfScaled(point.position_in_lidar_m.cast<double>() * voxels_per_m);
    if (seen.FindOrAdd(key) != chunk.keys.size()) continue;
    chunk.keys.push_back(key);
    chunk.indices.push_back(static_cast<std::uint32_t>(i));
  }
  return chunk;
}

void PickSparse(double voxel_size_m, SweepSamples* samples) {
  VoxelIndex seen(samples->points.size() / 4);
  const double voxels_per_m = 1.0 / voxel_size_m;
  for (std::size_t i = 0; i < samples->points.size(); ++i) {
    const Eigen::Vector3d position = samples->points[i].position_in_lidar_m.cast<double>();
    if (seen.FindOrAdd(VoxelKey::OfScaled(position * voxels_per_m)) != samples->sparse.size()) {
      continue;
    }
    samples->sparse.push_back(static_cast<std::uint32_t>(i));
  }
}

}  // namespace

SweepSamples SampleSweep(const LidarScan& scan, const SweepSampling& sampling) {
  std::vector<Chunk> chunks((scan.points.size() + kChunkPoints - 1) / kChunkPoints);
  tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t i) {
    const std::size_t begin = i * kChunkPoints;
    const std::size_t end = std::min(begin + kChunkPoints, scan.points.size());
    chunks[i] = SampleChunk(scan.points, begin, end, sampling);
  });
  SweepSamples samples;
  float first_s = std::numeric_limits<float>::max();
  float last_s = std::numeric_limits<float>::lowest();
  std::size_t num_kept = 0;
  for (const Chunk& chunk : chunks) {
    first_s = std::min(first_s, chunk.first_s);
    last_s = std::max(last_s, chunk.last_s);
    samples.num_in_range += chunk.num_in_range;
    num_kept += chunk.keys.size();
  }
  if (first_s > last_s) first_s = last_s = 0.0F;
  samples.stamp_ns = scan.stamp_ns;
  samples.first_ns = AddSeconds(scan.stamp_ns, first_s);
  samples.last_ns = AddSeconds(scan.stamp_ns, last_s);
  samples.mid_ns = samples.first_ns + (samples.last_ns - samples.first_ns) / 2;
  const auto mid_s = static_cast<float>(SecondsBetween(scan.stamp_ns, samples.mid_ns));
  samples.points.reserve(num_kept);
  VoxelIndex seen(num_kept);
  for (const Chunk& chunk : chunks) {
    for (std::size_t i = 0; i < chunk.keys.size(); ++i) {
      if (seen.FindOrAdd(chunk.keys[i]) != samples.points.size()) continue;
      const LidarPoint& point = scan.points[chunk.indices[i]];
      samples.points.push_back({point.position_in_lidar_m, point.time_offset_s - mid_s});
    }
  }
  PickSparse(sampling.sparse_voxel_m, &samples);
  return samples;
}

}  // namespace scenecalib
