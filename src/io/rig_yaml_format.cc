// The writing half of rig_yaml.h. Written by hand rather than by YAML::Emitter, so that numbers
// read back exactly and transforms stay on one line each.

#include <cctype>
#include <set>
#include <sstream>
#include <vector>

#include "scenecalib/io/atomic_file.h"
#include "scenecalib/io/rig_yaml.h"
#include "yaml_reader.h"

namespace scenecalib {
namespace {

std::string Quoted(const std::string& text) {
  static const char* const kHex = "0123456789abcdef";
  std::string quoted = "\"";
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (c == '"' || c == '\\') {
      quoted += std::string("\\") + c;
    } else if (byte < 0x20 || byte == 0x7f) {
      quoted += std::string("\\x") + kHex[byte >> 4] + kHex[byte & 15];
    } else {
      quoted += c;
    }
  }
  return quoted + "\"";
}

/// Plain where every YAML reader takes it for a text, else quoted.
std::string Text(const std::string& text) {
  static const std::set<std::string> kWords = {"true", "false", "yes", "no", "on",
                                               "off",  "null",  "y",   "n",  "nan"};
  std::string lower;
  bool plain = !text.empty();
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto c = static_cast<unsigned char>(text[i]);
    const bool letter = c < 0x80 && (std::isalpha(c) || c == '_' || c == '/');
    plain = plain && (letter || (i > 0 && c < 0x80 && (std::isdigit(c) || c == '-' || c == '.')));
    lower += static_cast<char>(std::tolower(c));
  }
  return plain && kWords.count(lower) == 0 ? text : Quoted(text);
}

std::string List(const std::vector<double>& numbers) {
  std::string list = "[";
  for (const double number : numbers) {
    list += (list.size() > 1 ? ", " : "") + FormatNumber(number);
  }
  return list + "]";
}

template <int N>
std::string List(const Eigen::Matrix<double, N, 1>& v) {
  return List(std::vector<double>(v.data(), v.data() + N));
}

std::string TextList(const std::vector<std::string>& texts) {
  std::string list = "[";
  for (const std::string& text : texts) list += (list.size() > 1 ? ", " : "") + Quoted(text);
  return list + "]";
}

const char* Boolean(bool value) { return value ? "true" : "false"; }

void PutTransform(const std::string& indent, const char* key, const Rigid3& transform,
                  std::ostream& out) {
  const Eigen::Quaterniond& q = transform.rotation;
  out << indent << key << ":\n"
      << indent << "  translation_m: " << List(transform.translation) << "\n"
      << indent << "  rotation_xyzw: " << List(q.coeffs()) << "\n";
}

void PutIntrinsics(const CameraIntrinsics& intrinsics, std::ostream& out) {
  out << "    intrinsics:\n"
      << "      model: " << intrinsics.model << "\n"
      << "      width_px: " << intrinsics.width_px << "\n"
      << "      height_px: " << intrinsics.height_px << "\n";
  if (!intrinsics.focal_px.empty()) {
    out << "      focal_px: " << List(intrinsics.focal_px) << "\n";
  }
  out << "      principal_point_px: " << List(intrinsics.principal_point_px) << "\n";
  if (!intrinsics.polynomial_px.empty()) {
    out << "      polynomial_px: " << List(intrinsics.polynomial_px) << "\n";
  }
  if (!intrinsics.distortion.empty()) {
    out << "      distortion: " << List(intrinsics.distortion) << "\n";
  }
}

void PutTolerances(const InitialStddev& stddev, std::ostream& out) {
  std::vector<std::string> entries;
  if (stddev.translation_m) entries.push_back("translation_m: " + List(*stddev.translation_m));
  if (stddev.rotation_rad) entries.push_back("rotation_rad: " + List(*stddev.rotation_rad));
  if (stddev.focal_scale) entries.push_back("focal_scale: " + FormatNumber(*stddev.focal_scale));
  if (stddev.principal_point_px) {
    entries.push_back("principal_point_px: " + List(*stddev.principal_point_px));
  }
  if (stddev.time_offset_s) {
    entries.push_back("time_offset_s: " + FormatNumber(*stddev.time_offset_s));
  }
  if (entries.empty()) return;
  out << "    initial_stddev:\n";
  for (const std::string& entry : entries) out << "      " << entry << "\n";
}

void PutRate(const char* key, const std::optional<MiscalibrationRate>& rate, std::ostream& out) {
  if (!rate) return;
  out << "      " << key << ": {x: " << FormatNumber(rate->x) << ", y: " << FormatNumber(rate->y)
      << ", z: " << FormatNumber(rate->z) << ", roll: " << FormatNumber(rate->roll)
      << ", pitch: " << FormatNumber(rate->pitch) << ", yaw: " << FormatNumber(rate->yaw) << "}\n";
}

void PutQuality(const CameraQuality& quality, std::ostream& out) {
  const CameraStddev& stddev = quality.stddev;
  out << "    quality:\n"
      << "      accepted: " << Boolean(quality.accepted) << "\n"
      << "      reasons: " << TextList(quality.reasons) << "\n"
      << "      num_tracks: " << quality.num_tracks << "\n"
      << "      num_inlier_tracks: " << quality.num_inlier_tracks << "\n"
      << "      num_cross_camera_matches: " << quality.num_cross_camera_matches << "\n"
      << "      rms_before_px: " << FormatNumber(quality.rms_before_px) << "\n"
      << "      rms_after_px: " << FormatNumber(quality.rms_after_px) << "\n"
      << "      stddev:\n"
      << "        translation_m: " << List(stddev.translation_m) << "\n"
      << "        rotation_rad: " << List(stddev.rotation_rad) << "\n"
      << "        focal_scale: " << FormatNumber(stddev.focal_scale) << "\n"
      << "        principal_point_px: " << List(stddev.principal_point_px) << "\n"
      << "        time_offset_s: " << FormatNumber(stddev.time_offset_s) << "\n";
  PutRate("miscalibration_rate_before", quality.miscalibration_rate_before, out);
  PutRate("miscalibration_rate_after", quality.miscalibration_rate_after, out);
}

void PutCamera(const CameraConfig& camera, std::ostream& out) {
  out << "  " << Text(camera.name) << ":\n"
      << "    image_topic: " << Text(camera.image_topic) << "\n";
  if (camera.camera_info_topic) {
    out << "    camera_info_topic: " << Text(*camera.camera_info_topic) << "\n";
  }
  out << "    frame_id: " << Text(camera.frame_id) << "\n"
      << "    time_offset_s: " << FormatNumber(camera.time_offset_s) << "\n";
  PutTransform("    ", "lidar_from_camera", camera.lidar_from_camera, out);
  PutTolerances(camera.initial_stddev, out);
  if (camera.mask_file) out << "    mask: " << Text(*camera.mask_file) << "\n";
  if (camera.rolling_shutter_line_time_s) {
    out << "    rolling_shutter_line_time_s: " << FormatNumber(*camera.rolling_shutter_line_time_s)
        << "\n";
  }
  if (camera.model) PutIntrinsics(camera.model->intrinsics(), out);
}

void PutOtherSensors(const Rig& rig, std::ostream& out) {
  out << "lidar:\n"
      << "  topic: " << Text(rig.lidar.topic) << "\n"
      << "  frame_id: " << Text(rig.lidar.frame_id) << "\n"
      << "  motion_compensated: " << Boolean(rig.lidar.motion_compensated) << "\n";
  if (rig.lidar.scan_period_s) {
    out << "  scan_period_s: " << FormatNumber(*rig.lidar.scan_period_s) << "\n";
  }
  if (rig.imu) {
    out << "imu:\n  topic: " << Text(rig.imu->topic) << "\n";
    PutTransform("  ", "lidar_from_imu", rig.imu->lidar_from_imu, out);
  }
  if (rig.odometry) {
    out << "odometry:\n  topic: " << Text(rig.odometry->topic) << "\n";
    PutTransform("  ", "lidar_from_body", rig.odometry->lidar_from_body, out);
  }
  if (rig.fallback_file) out << "fallback: " << Text(*rig.fallback_file) << "\n";
}

}  // namespace

std::string FormatRig(const Rig& rig) {
  std::ostringstream out;
  PutOtherSensors(rig, out);
  out << "cameras:\n";
  for (const CameraConfig& camera : rig.cameras) PutCamera(camera, out);
  return out.str();
}

Status WriteRig(const std::string& path, const Rig& rig) {
  return WriteFileAtomically(path, FormatRig(rig));
}

std::string FormatCalibration(const CalibrationResult& result) {
  std::ostringstream out;
  out << "quality:\n"
      << "  accepted: " << Boolean(result.accepted) << "\n"
      << "  reasons: " << TextList(result.reasons) << "\n";
  PutOtherSensors(result.rig, out);
  out << "cameras:\n";
  for (std::size_t i = 0; i < result.rig.cameras.size(); ++i) {
    PutCamera(result.rig.cameras[i], out);
    PutQuality(result.cameras.at(i), out);
  }
  return out.str();
}

Status WriteCalibration(const std::string& path, const CalibrationResult& result) {
  return WriteFileAtomically(path, FormatCalibration(result));
}

}  // namespace scenecalib
