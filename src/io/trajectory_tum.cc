#include "scenecalib/io/trajectory_tum.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <locale>
#include <sstream>
#include <utility>
#include <vector>

#include "scenecalib/io/atomic_file.h"
#include "scenecalib/io/options_yaml.h"
#include "yaml_reader.h"

namespace scenecalib {
namespace {

constexpr double kMaxQuaternionNormError = 1e-3;
constexpr double kUnitByRounding = 1e-14;
constexpr Timestamp kNanosecondsPerSecond = 1000000000;

/// Decimal seconds to nanoseconds without passing through a double, which holds a Unix time to a
/// quarter of a microsecond only. Digits beyond the ninth are cut off.
bool ParseStamp(const std::string& text, Timestamp* stamp_ns) {
  const std::size_t point = std::min(text.find('.'), text.size());
  const bool negative = !text.empty() && text.front() == '-';
  Timestamp seconds = 0;
  const char* end = text.data() + point;
  const auto whole = std::from_chars(text.data(), end, seconds);
  if (whole.ec != std::errc() || whole.ptr != end || std::abs(seconds) > 9000000000) return false;
  std::string fraction = point < text.size() ? text.substr(point + 1) : "";
  if (!std::all_of(fraction.begin(), fraction.end(), [](char c) { return c >= '0' && c <= '9'; })) {
    return false;
  }
  fraction.resize(9, '0');
  const Timestamp nanoseconds = std::stoll(fraction);
  *stamp_ns = seconds * kNanosecondsPerSecond + (negative ? -nanoseconds : nanoseconds);
  return true;
}

bool ParsePose(std::istream& line, TimedPose* pose) {
  std::string stamp;
  std::array<double, 7> v;
  line >> stamp;
  for (double& number : v) line >> number;
  std::string rest;
  if (line.fail() || (line >> rest) || !ParseStamp(stamp, &pose->stamp_ns)) return false;
  Eigen::Quaterniond rotation(v[6], v[3], v[4], v[5]);
  const double norm_error = std::abs(rotation.norm() - 1.0);
  if (!(norm_error <= kMaxQuaternionNormError)) return false;
  if (norm_error > kUnitByRounding) rotation.normalize();
  pose->map_from_lidar.rotation = rotation;
  pose->map_from_lidar.translation = {v[0], v[1], v[2]};
  return true;
}

std::string FormatStamp(Timestamp stamp_ns) {
  const Timestamp magnitude = std::abs(stamp_ns);
  std::string fraction = std::to_string(magnitude % kNanosecondsPerSecond);
  fraction.insert(0, 9 - fraction.size(), '0');
  return (stamp_ns < 0 ? "-" : "") + std::to_string(magnitude / kNanosecondsPerSecond) + "." +
         fraction;
}

}  // namespace

Result<Trajectory> ParseTrajectoryTum(const std::string& text, const std::string& source_name) {
  std::vector<TimedPose> poses;
  std::istringstream lines(text);
  std::string line;
  for (int number = 1; std::getline(lines, line); ++number) {
    const std::size_t first = line.find_first_not_of(" \t\r");
    if (first == std::string::npos || line[first] == '#') continue;
    std::istringstream stream(line);
    stream.imbue(std::locale::classic());
    TimedPose pose;
    const std::string place = source_name + ": line " + std::to_string(number);
    if (!ParsePose(stream, &pose)) {
      return Status::InvalidArgument(place + " is '" + line +
                                     "', must be stamp_s x y z qx qy qz qw with a unit quaternion");
    }
    if (!poses.empty() && pose.stamp_ns <= poses.back().stamp_ns) {
      return Status::InvalidArgument(place + ": stamp " + FormatStamp(pose.stamp_ns) +
                                     " is not after the one before, " +
                                     FormatStamp(poses.back().stamp_ns));
    }
    poses.push_back(pose);
  }
  Result<Trajectory> trajectory = Trajectory::Create(std::move(poses));
  if (trajectory.ok()) return trajectory;
  return Status::InvalidArgument(source_name + ": " + trajectory.status().message());
}

Result<Trajectory> ReadTrajectoryTum(const std::string& path) {
  const Result<std::string> text = internal::ReadTextFile(path);
  if (!text.ok()) return text.status();
  return ParseTrajectoryTum(*text, path);
}

std::string FormatTrajectoryTum(const Trajectory& trajectory) {
  std::string text = "# stamp_s x y z qx qy qz qw\n";
  for (const TimedPose& pose : trajectory.poses()) {
    const Eigen::Vector3d& t = pose.map_from_lidar.translation;
    const Eigen::Quaterniond& q = pose.map_from_lidar.rotation;
    text += FormatStamp(pose.stamp_ns);
    for (const double v : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()}) {
      text += " " + FormatNumber(v);
    }
    text += "\n";
  }
  return text;
}

Status WriteTrajectoryTum(const std::string& path, const Trajectory& trajectory) {
  return WriteFileAtomically(path, FormatTrajectoryTum(trajectory));
}

}  // namespace scenecalib
