#include "scenecalib/sensor/point_cloud_decoder.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <initializer_list>
#include <map>
#include <optional>
#include <utility>

namespace scenecalib {
namespace {

constexpr double kTurn = 2.0 * 3.14159265358979323846;
constexpr double kAbsoluteSeconds = 1e6;       // a sweep is shorter, an epoch longer
constexpr double kAbsoluteNanoseconds = 1e14;  // three years of seconds are not a stamp
constexpr double kMaxOffsetS = 2.0;            // between a point and its message's stamp

std::uint32_t SizeOf(std::uint8_t datatype) {
  constexpr std::uint32_t kSizes[] = {0, 1, 1, 2, 2, 4, 4, 4, 8};
  return datatype <= 8 ? kSizes[datatype] : 0;
}

bool IsFloat(const PointCloudField& field) { return field.datatype >= 7; }

template <typename T>
double Load(const std::uint8_t* bytes, bool swap) {
  std::uint8_t buffer[sizeof(T)];
  std::memcpy(buffer, bytes, sizeof(T));
  if (swap) std::reverse(buffer, buffer + sizeof(T));
  T value;
  std::memcpy(&value, buffer, sizeof(T));
  return static_cast<double>(value);
}

/// A field's value of one point.
double Read(const std::uint8_t* point, const PointCloudField& field, bool swap) {
  const std::uint8_t* bytes = point + field.offset;
  switch (field.datatype) {
    case 1:
      return Load<std::int8_t>(bytes, swap);
    case 2:
      return Load<std::uint8_t>(bytes, swap);
    case 3:
      return Load<std::int16_t>(bytes, swap);
    case 4:
      return Load<std::uint16_t>(bytes, swap);
    case 5:
      return Load<std::int32_t>(bytes, swap);
    case 6:
      return Load<std::uint32_t>(bytes, swap);
    case 7:
      return Load<float>(bytes, swap);
    default:
      return Load<double>(bytes, swap);
  }
}

bool HostIsBigEndian() {
  const std::uint16_t one = 1;
  std::uint8_t first;
  std::memcpy(&first, &one, 1);
  return first == 0;
}

std::optional<PointCloudField> Find(const PointCloudView& cloud,
                                    std::initializer_list<const char*> names) {
  for (const char* name : names) {
    for (const PointCloudField& field : cloud.fields) {
      if (field.name == name && field.count != 0) return field;
    }
  }
  return std::nullopt;
}

std::string FieldNames(const PointCloudView& cloud) {
  std::string names;
  for (const PointCloudField& field : cloud.fields) {
    names += (names.empty() ? "" : ", ") + field.name;
  }
  return names.empty() ? "none" : names;
}

/// Everything that must hold before a byte is read.
Status CheckLayout(const PointCloudView& cloud, const std::string& who) {
  if (cloud.width == 0 || cloud.height == 0) {
    return Status::InsufficientData(who + ": the cloud has no points");
  }
  for (const PointCloudField& field : cloud.fields) {
    const std::uint32_t size = SizeOf(field.datatype);
    if (size == 0) {
      return Status::InvalidArgument(who + ": field '" + field.name +
                                     "' has the unknown datatype " +
                                     std::to_string(field.datatype));
    }
    if (static_cast<std::uint64_t>(field.offset) + size > cloud.point_step) {
      return Status::InvalidArgument(who + ": field '" + field.name +
                                     "' reaches beyond the point step of " +
                                     std::to_string(cloud.point_step) + " bytes");
    }
  }
  const std::uint64_t row_bytes = static_cast<std::uint64_t>(cloud.width) * cloud.point_step;
  if (cloud.height > 1 && cloud.row_step < row_bytes) {
    return Status::InvalidArgument(who + ": row step " + std::to_string(cloud.row_step) +
                                   " is less than the " + std::to_string(row_bytes) +
                                   " bytes of a row");
  }
  const std::uint64_t needed =
      static_cast<std::uint64_t>(cloud.height - 1) * cloud.row_step + row_bytes;
  if (cloud.data == nullptr || cloud.size < needed) {
    return Status::InvalidArgument(who + ": the cloud is cut short, " + std::to_string(cloud.size) +
                                   " of " + std::to_string(needed) + " bytes");
  }
  for (const char* name : {"x", "y", "z"}) {
    if (!Find(cloud, {name})) {
      return Status::InvalidArgument(who + ": field '" + name +
                                     "' is missing (fields: " + FieldNames(cloud) + ")");
    }
  }
  return Status::Ok();
}

/// Seconds after the stamp from a time field's value.
double OffsetSeconds(double value, const PointCloudField& field, Timestamp stamp_ns) {
  if (!IsFloat(field)) return 1e-9 * value;
  if (std::abs(value) < kAbsoluteSeconds) return value;
  const bool nanoseconds = std::abs(value) > kAbsoluteNanoseconds;
  const auto whole_s = static_cast<double>(stamp_ns / 1000000000);
  const double fraction_s = 1e-9 * static_cast<double>(stamp_ns % 1000000000);
  return nanoseconds ? 1e-9 * (value - 1e9 * whole_s) - fraction_s : (value - whole_s) - fraction_s;
}

/// Angle wrapped to [-pi, pi).
double Wrapped(double angle) { return angle - kTurn * std::floor(angle / kTurn + 0.5); }

/// Point times from azimuth. `lines[i]` names the sequence (ring or row) a point belongs to; along
/// a sequence the azimuth is followed without wrapping, so a point a little before the first one
/// does not land at the sweep's end.
void TimeByAzimuth(const std::vector<int>& lines, double period_s,
                   std::vector<LidarPoint>* points) {
  const auto azimuth = [](const LidarPoint& point) {
    return std::atan2(static_cast<double>(point.position_in_lidar_m.y()),
                      static_cast<double>(point.position_in_lidar_m.x()));
  };
  double turned = 0.0;
  std::map<int, double> last_azimuth;
  for (std::size_t i = 0; i < points->size(); ++i) {
    const double now = azimuth((*points)[i]);
    const auto [it, is_first] = last_azimuth.try_emplace(lines[i], now);
    const double step = Wrapped(now - it->second);
    if (!is_first && std::abs(step) < 0.25 * kTurn) turned += step;
    it->second = now;
  }
  const double direction = turned < 0.0 ? -1.0 : 1.0;
  const double first = azimuth(points->front());
  struct Follow {
    double azimuth = 0.0;
    double angle = 0.0;
  };
  std::map<int, Follow> follows;
  std::vector<double> angles(points->size());
  double largest = 0.0;
  for (std::size_t i = 0; i < points->size(); ++i) {
    const double now = azimuth((*points)[i]);
    const auto [it, is_first] = follows.try_emplace(lines[i]);
    Follow& follow = it->second;
    // A sequence may begin anywhere when returns are missing; only "a little before" is negative.
    const double from_first = direction * Wrapped(now - first);
    follow.angle = is_first ? (from_first < -0.1 * kTurn ? from_first + kTurn : from_first)
                            : follow.angle + direction * Wrapped(now - follow.azimuth);
    follow.azimuth = now;
    angles[i] = follow.angle;
    largest = std::max(largest, follow.angle);
  }
  for (std::size_t i = 0; i < points->size(); ++i) {
    double share = angles[i] / kTurn;
    // Many turns in one sequence: rings one after the other in a cloud that does not tell them.
    if (largest > 1.5 * kTurn) share -= std::floor(share);
    (*points)[i].time_offset_s = static_cast<float>(share * period_s);
  }
}

}  // namespace

Result<LidarScan> DecodePointCloud(const PointCloudView& cloud, const LidarConfig& config) {
  const std::string who = "lidar topic " + config.topic;
  SCENECALIB_RETURN_IF_ERROR(CheckLayout(cloud, who));
  const auto time =
      Find(cloud, {"time", "t", "timestamp", "offset_time", "time_offset", "time_stamp"});
  const bool by_field = !config.motion_compensated && time.has_value();
  const bool by_azimuth = !config.motion_compensated && !time && config.scan_period_s.has_value();
  if (!config.motion_compensated && !by_field && !by_azimuth) {
    return Status::InvalidArgument(
        who + ": no per-point time (a field time, t, timestamp or offset_time; the cloud has " +
        FieldNames(cloud) + "): set lidar.scan_period_s, or lidar.motion_compensated");
  }
  const bool swap = cloud.is_bigendian != HostIsBigEndian();
  const auto intensity = Find(cloud, {"intensity", "reflectivity"});
  const auto ring = Find(cloud, {"ring", "channel", "line", "laser_id"});
  const PointCloudField x = *Find(cloud, {"x"});
  const PointCloudField y = *Find(cloud, {"y"});
  const PointCloudField z = *Find(cloud, {"z"});

  LidarScan scan;
  scan.stamp_ns = cloud.stamp_ns;
  scan.points.reserve(static_cast<std::size_t>(cloud.width) * cloud.height);
  std::vector<int> lines;
  for (std::uint32_t row = 0; row < cloud.height; ++row) {
    for (std::uint32_t column = 0; column < cloud.width; ++column) {
      const std::uint8_t* bytes = cloud.data + static_cast<std::size_t>(row) * cloud.row_step +
                                  static_cast<std::size_t>(column) * cloud.point_step;
      LidarPoint point;
      point.position_in_lidar_m =
          Eigen::Vector3d(Read(bytes, x, swap), Read(bytes, y, swap), Read(bytes, z, swap))
              .cast<float>();
      if (!point.position_in_lidar_m.allFinite() || point.position_in_lidar_m.norm() < 1e-3F) {
        continue;
      }
      if (by_field) {
        const double offset_s = OffsetSeconds(Read(bytes, *time, swap), *time, cloud.stamp_ns);
        if (!std::isfinite(offset_s)) continue;
        if (std::abs(offset_s) > kMaxOffsetS) {
          return Status::InvalidArgument(
              who + ": field '" + time->name + "' puts a point " + std::to_string(offset_s) +
              " s from the message's stamp: points and stamp must share one clock");
        }
        point.time_offset_s = static_cast<float>(offset_s);
      }
      if (intensity) point.intensity = static_cast<float>(Read(bytes, *intensity, swap));
      const double line = ring ? Read(bytes, *ring, swap) : static_cast<double>(row);
      point.ring = static_cast<std::uint16_t>(std::clamp(line, 0.0, 65535.0));
      scan.points.push_back(point);
      if (by_azimuth) lines.push_back(point.ring);
    }
  }
  if (scan.points.empty()) {
    return Status::InsufficientData(who + ": the cloud has no finite point");
  }
  if (by_azimuth) TimeByAzimuth(lines, *config.scan_period_s, &scan.points);
  return scan;
}

}  // namespace scenecalib
