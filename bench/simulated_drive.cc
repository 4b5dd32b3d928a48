#include "bench/simulated_drive.h"

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <system_error>
#include <type_traits>
#include <utility>

#include "scenecalib/io/rig_yaml.h"

namespace scenecalib {
namespace {

namespace fs = std::filesystem;

static_assert(std::is_trivially_copyable<float>::value, "points are written as they are");

struct PackedPoint {
  float x, y, z, time_offset_s, intensity;
  std::uint32_t ring;
};

bool ReadScan(const std::string& path, LidarScan* scan) {
  std::ifstream file(path, std::ios::binary);
  std::uint64_t size = 0;
  if (!file.read(reinterpret_cast<char*>(&scan->stamp_ns), sizeof(scan->stamp_ns)) ||
      !file.read(reinterpret_cast<char*>(&size), sizeof(size))) {
    return false;
  }
  std::vector<PackedPoint> packed(size);
  if (!file.read(reinterpret_cast<char*>(packed.data()),
                 static_cast<std::streamsize>(size * sizeof(PackedPoint)))) {
    return false;
  }
  scan->points.reserve(size);
  for (const PackedPoint& p : packed) {
    scan->points.push_back(
        {{p.x, p.y, p.z}, p.time_offset_s, p.intensity, static_cast<std::uint16_t>(p.ring)});
  }
  return true;
}

void WriteScan(const std::string& path, const LidarScan& scan) {
  std::vector<PackedPoint> packed;
  packed.reserve(scan.points.size());
  for (const LidarPoint& p : scan.points) {
    const Eigen::Vector3f& x = p.position_in_lidar_m;
    packed.push_back({x.x(), x.y(), x.z(), p.time_offset_s, p.intensity, p.ring});
  }
  const std::uint64_t size = packed.size();
  std::ofstream file(path + ".part", std::ios::binary);
  file.write(reinterpret_cast<const char*>(&scan.stamp_ns), sizeof(scan.stamp_ns));
  file.write(reinterpret_cast<const char*>(&size), sizeof(size));
  file.write(reinterpret_cast<const char*>(packed.data()),
             static_cast<std::streamsize>(size * sizeof(PackedPoint)));
  file.close();
  std::error_code error;
  if (file) fs::rename(path + ".part", path, error);
}

SimulationOptions Options(const DriveSpec& spec) {
  SimulationOptions options;
  options.world.kind = spec.world;
  options.drive.kind = spec.drive;
  options.drive.speed_m_s = spec.speed_m_s;
  options.world.num_moving_cars = spec.num_moving_cars;
  options.seed = spec.seed;
  options.duration_s = spec.duration_s;
  options.lidar = spec.lidar;
  options.start = spec.start;
  return options;
}

}  // namespace

std::string Describe(const DriveSpec& spec) {
  char text[160];
  std::snprintf(text, sizeof(text), "%s/%s seed %d, %.0f s at %.0f m/s, %d x %d",
                spec.world.c_str(), spec.drive.c_str(), spec.seed, spec.duration_s, spec.speed_m_s,
                spec.lidar.rings, spec.lidar.columns);
  std::string description = text;
  if (spec.num_moving_cars != DriveSpec().num_moving_cars) {
    description += ", " + std::to_string(spec.num_moving_cars) + " moving cars";
  }
  const SimulatedLidarOptions& lidar = spec.lidar;
  if (lidar.ring_range_m > 0.0 || lidar.ring_angle_deg > 0.0 || lidar.beam_mrad > 0.0) {
    std::snprintf(text, sizeof(text), ", lasers off by %.3f m and %.3f deg, beams of %.1f mrad",
                  lidar.ring_range_m, lidar.ring_angle_deg, lidar.beam_mrad);
    description += text;
  }
  return description;
}

Result<SimulatedDrive> SimulatedDrive::Create(const DriveSpec& spec) {
  const Result<Rig> rig = spec.rig.empty() ? DefaultRig() : ReadRig(spec.rig);
  if (!rig.ok()) return rig.status();
  Result<Simulator> simulator = Simulator::Create(*rig, Options(spec));
  if (!simulator.ok()) return simulator.status();
  SimulatedDrive drive(std::move(*simulator));
  if (!spec.cache_directory.empty()) {
    std::string name = Describe(spec);
    for (char& c : name) c = c == ' ' || c == '/' || c == ',' ? '_' : c;
    if (!spec.rig.empty()) name += "_" + fs::path(spec.rig).stem().string();
    drive.cache_ = spec.cache_directory + "/" + name;
    fs::create_directories(drive.cache_);
  }
  for (const ScheduledMeasurement& item : drive.simulator_.schedule()) {
    if (item.kind == MeasurementKind::kImu) {
      drive.imu_.push_back(drive.simulator_.Imu(item.index));
    } else if (item.kind == MeasurementKind::kOdometry) {
      drive.odometry_.push_back(drive.simulator_.Odometry(item.index));
    }
  }
  return drive;
}

LidarScan SimulatedDrive::Scan(int index) const {
  if (cache_.empty()) return simulator_.CastScan(index);
  const std::string path = cache_ + "/" + std::to_string(index) + ".bin";
  LidarScan scan;
  if (ReadScan(path, &scan)) return scan;
  scan = simulator_.CastScan(index);
  WriteScan(path, scan);
  return scan;
}

GrayImage SimulatedDrive::Image(int camera, int index) const {
  constexpr int kJpegQuality = 95;
  GrayImage image;
  for (const ScheduledMeasurement& item : simulator_.schedule()) {
    if (item.kind == MeasurementKind::kImage && item.camera == camera && item.index == index) {
      image.stamp_ns = item.stamp_ns;
    }
  }
  const std::string path = cache_ + "/" + rig().cameras[static_cast<std::size_t>(camera)].name +
                           "_" + std::to_string(index) + ".jpg";
  if (!cache_.empty() && fs::exists(path)) {
    image.pixels = cv::imread(path, cv::IMREAD_GRAYSCALE);
  }
  if (!image.pixels.empty()) return image;
  const cv::Mat colour = simulator_.RenderImage(camera, index);
  std::vector<uchar> jpeg;
  cv::imencode(".jpg", colour, jpeg, {cv::IMWRITE_JPEG_QUALITY, kJpegQuality});
  image.pixels = cv::imdecode(jpeg, cv::IMREAD_GRAYSCALE);
  if (!cache_.empty()) {
    std::ofstream(path, std::ios::binary)
        .write(reinterpret_cast<const char*>(jpeg.data()),
               static_cast<std::streamsize>(jpeg.size()));
  }
  return image;
}

}  // namespace scenecalib
