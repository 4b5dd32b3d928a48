#include "scenecalib/io/rig_yaml.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <map>
#include <vector>

#include "scenecalib/io/options_yaml.h"
#include "scenecalib/sensor/camera_factory.h"
#include "yaml_reader.h"

namespace scenecalib {
namespace {

constexpr OptionBound kTranslationM = {-100.0, 100.0};  // no vehicle is longer
constexpr OptionBound kTimeOffsetS = {-3600.0, 3600.0};
constexpr OptionBound kScanPeriodS = {0.001, 10.0};
constexpr OptionBound kLineTimeS = {-0.001, 0.001};  // negative: read from the bottom row upwards
constexpr OptionBound kImageSizePx = {1.0, 65536.0};
constexpr OptionBound kStddevM = {1e-5, 10.0};
constexpr OptionBound kStddevRad = {1e-6, 3.15};
constexpr OptionBound kStddevShare = {1e-7, 1.0};
constexpr OptionBound kStddevPx = {1e-4, 1e4};
constexpr OptionBound kStddevS = {1e-6, 10.0};
constexpr OptionBound kFocalPx = {1e-3, 1e5};
// Numbers written with four digits pass, a forgotten or doubled one does not.
constexpr double kMaxQuaternionNormError = 1e-3;
// What a product of normalised quaternions may be off by: such a file reads back as it was written.
constexpr double kUnitByRounding = 1e-14;

/// A ROS graph name: the one that a subscriber throws on would end the program later.
std::string Topic(const YamlReader& reader) {
  const std::string topic = reader.String();
  if (!reader.status().ok()) return topic;
  const auto allowed = [](unsigned char c) { return std::isalnum(c) || c == '_' || c == '/'; };
  const unsigned char first = static_cast<unsigned char>(topic.front());
  if (!std::all_of(topic.begin(), topic.end(), allowed) || !(std::isalpha(first) || first == '/') ||
      topic.back() == '/') {
    reader.FailValue("a ROS topic (letters, digits, _ and /)");
  }
  return topic;
}

std::string FrameId(const YamlReader& reader) {
  const std::string frame_id = reader.String();
  const auto is_space = [](unsigned char c) { return std::isspace(c) != 0; };
  if (reader.status().ok() &&
      (frame_id.front() == '/' || std::any_of(frame_id.begin(), frame_id.end(), is_space))) {
    reader.FailValue("a tf2 frame (no leading slash, no space)");
  }
  return frame_id;
}

Rigid3 Transform(const YamlReader& reader) {
  reader.CheckKeys({"translation_m", "rotation_xyzw"});
  const std::vector<double> t = reader.Child("translation_m").Numbers(3, kTranslationM);
  const YamlReader rotation = reader.Child("rotation_xyzw");
  const std::vector<double> q = rotation.Numbers(4);
  Rigid3 transform;
  if (!reader.status().ok()) return transform;
  transform.translation = {t[0], t[1], t[2]};
  transform.rotation = Eigen::Quaterniond(q[3], q[0], q[1], q[2]);
  const double norm = transform.rotation.norm();
  if (!(std::abs(norm - 1.0) <= kMaxQuaternionNormError)) {
    rotation.Fail(" is [" + FormatNumber(q[0]) + ", " + FormatNumber(q[1]) + ", " +
                  FormatNumber(q[2]) + ", " + FormatNumber(q[3]) + "] with norm " +
                  FormatNumber(norm) + ", must be a unit quaternion x, y, z, w (norm within " +
                  FormatNumber(kMaxQuaternionNormError) + " of 1)");
  } else if (std::abs(norm - 1.0) > kUnitByRounding) {
    transform.rotation.normalize();
  }
  return transform;
}

std::size_t DistortionCount(const std::string& model) {
  return model == "plumb_bob" ? 5 : model == "rational_polynomial" ? 8 : 4;
}

CameraModelPtr Intrinsics(const YamlReader& reader) {
  CameraIntrinsics intrinsics;
  const YamlReader model = reader.Child("model");
  intrinsics.model = model.String();
  const std::vector<std::string> models = {"ftheta", "plumb_bob", "rational_polynomial",
                                           "equidistant"};
  if (std::find(models.begin(), models.end(), intrinsics.model) == models.end()) {
    model.FailValue("ftheta, plumb_bob, rational_polynomial or equidistant");
  }
  const bool ftheta = intrinsics.model == "ftheta";
  std::vector<std::string> keys = {"model", "width_px", "height_px", "principal_point_px"};
  if (ftheta) {
    keys.push_back("polynomial_px");
  } else {
    keys.insert(keys.end(), {"focal_px", "distortion"});
  }
  reader.CheckKeys(keys);
  intrinsics.width_px = reader.Child("width_px").Integer(kImageSizePx);
  intrinsics.height_px = reader.Child("height_px").Integer(kImageSizePx);
  const std::vector<double> center = reader.Child("principal_point_px").Numbers(2);
  intrinsics.principal_point_px = {center[0], center[1]};
  if (ftheta) {
    intrinsics.polynomial_px = reader.Child("polynomial_px").Numbers(5);
  } else {
    intrinsics.focal_px = reader.Child("focal_px").Numbers(2, kFocalPx);
    intrinsics.distortion = reader.Child("distortion").Numbers(DistortionCount(intrinsics.model));
  }
  if (!reader.status().ok()) return nullptr;
  const Result<CameraModelPtr> camera = CreateCameraModel(intrinsics);
  if (camera.ok()) return *camera;
  reader.Fail(": " + camera.status().message());
  return nullptr;
}

MiscalibrationRate Rate(const YamlReader& reader) {
  reader.CheckKeys({"x", "y", "z", "roll", "pitch", "yaw"});
  const auto at = [&reader](const char* axis) { return reader.Child(axis).AnyNumber(); };
  return {at("x"), at("y"), at("z"), at("roll"), at("pitch"), at("yaw")};
}

CameraStddev Stddev(const YamlReader& reader) {
  reader.CheckKeys(
      {"translation_m", "rotation_rad", "focal_scale", "principal_point_px", "time_offset_s"});
  CameraStddev stddev;
  const std::vector<double> translation = reader.Child("translation_m").AnyNumbers(3);
  const std::vector<double> rotation = reader.Child("rotation_rad").AnyNumbers(3);
  const std::vector<double> center = reader.Child("principal_point_px").AnyNumbers(2);
  stddev.focal_scale = reader.Child("focal_scale").AnyNumber();
  stddev.time_offset_s = reader.Child("time_offset_s").AnyNumber();
  if (!reader.status().ok()) return stddev;
  stddev.translation_m = Eigen::Vector3d(translation.data());
  stddev.rotation_rad = Eigen::Vector3d(rotation.data());
  stddev.principal_point_px = Eigen::Vector2d(center.data());
  return stddev;
}

/// A camera's quality block: an earlier run's.
CameraQuality Quality(const YamlReader& reader) {
  reader.CheckKeys({"accepted", "reasons", "num_tracks", "num_inlier_tracks",
                    "num_cross_camera_matches", "rms_before_px", "rms_after_px", "stddev",
                    "miscalibration_rate_before", "miscalibration_rate_after"});
  const auto count = [&reader](const char* key) {
    return reader.Child(key).Integer({0.0, 2147483647.0});
  };
  CameraQuality quality;
  quality.accepted = reader.Child("accepted").Boolean();
  quality.reasons = reader.Child("reasons").Strings();
  quality.num_tracks = count("num_tracks");
  quality.num_inlier_tracks = count("num_inlier_tracks");
  quality.num_cross_camera_matches = count("num_cross_camera_matches");
  quality.rms_before_px = reader.Child("rms_before_px").AnyNumber();
  quality.rms_after_px = reader.Child("rms_after_px").AnyNumber();
  quality.stddev = Stddev(reader.Child("stddev"));
  if (const auto rate = reader.OptionalChild("miscalibration_rate_before")) {
    quality.miscalibration_rate_before = Rate(*rate);
  }
  if (const auto rate = reader.OptionalChild("miscalibration_rate_after")) {
    quality.miscalibration_rate_after = Rate(*rate);
  }
  return quality;
}

InitialStddev Tolerances(const YamlReader& reader) {
  reader.CheckKeys(
      {"translation_m", "rotation_rad", "focal_scale", "principal_point_px", "time_offset_s"});
  InitialStddev stddev;
  const auto numbers = [&reader](const char* key, int count, OptionBound bound) {
    const auto child = reader.OptionalChild(key);
    return child ? child->Numbers(static_cast<std::size_t>(count), bound) : std::vector<double>();
  };
  const std::vector<double> translation = numbers("translation_m", 3, kStddevM);
  const std::vector<double> rotation = numbers("rotation_rad", 3, kStddevRad);
  const std::vector<double> center = numbers("principal_point_px", 2, kStddevPx);
  const auto focal_scale = reader.OptionalChild("focal_scale");
  const auto time_offset = reader.OptionalChild("time_offset_s");
  if (focal_scale) stddev.focal_scale = focal_scale->Number(kStddevShare);
  if (time_offset) stddev.time_offset_s = time_offset->Number(kStddevS);
  if (!reader.status().ok()) return stddev;
  if (!translation.empty()) stddev.translation_m = Eigen::Vector3d(translation.data());
  if (!rotation.empty()) stddev.rotation_rad = Eigen::Vector3d(rotation.data());
  if (!center.empty()) stddev.principal_point_px = Eigen::Vector2d(center.data());
  return stddev;
}

CameraConfig Camera(const std::string& name, const YamlReader& reader) {
  CameraConfig camera;
  camera.name = name;
  if (name.empty() || name == "." || name == ".." || name.find('/') != std::string::npos) {
    reader.Fail(
        " is a camera name that cannot be a file name, must not be empty, '.', '..' or "
        "contain '/'");
  }
  reader.CheckKeys({"image_topic", "camera_info_topic", "frame_id", "time_offset_s",
                    "lidar_from_camera", "initial_stddev", "mask", "rolling_shutter_line_time_s",
                    "intrinsics", "quality"});
  camera.image_topic = Topic(reader.Child("image_topic"));
  if (const auto topic = reader.OptionalChild("camera_info_topic")) {
    camera.camera_info_topic = Topic(*topic);
  }
  camera.frame_id = FrameId(reader.Child("frame_id"));
  if (const auto offset = reader.OptionalChild("time_offset_s")) {
    camera.time_offset_s = offset->Number(kTimeOffsetS);
  }
  if (const auto mask = reader.OptionalChild("mask")) {
    camera.mask_file = mask->String();
  }
  if (const auto line_time = reader.OptionalChild("rolling_shutter_line_time_s")) {
    camera.rolling_shutter_line_time_s = line_time->Number(kLineTimeS);
  }
  camera.lidar_from_camera = Transform(reader.Child("lidar_from_camera"));
  if (const auto stddev = reader.OptionalChild("initial_stddev")) {
    camera.initial_stddev = Tolerances(*stddev);
  }
  if (const auto intrinsics = reader.OptionalChild("intrinsics")) {
    camera.model = Intrinsics(*intrinsics);
  } else if (!camera.camera_info_topic) {
    reader.Fail(".intrinsics is missing, and there is no camera_info_topic to take them from");
  }
  if (const auto quality = reader.OptionalChild("quality")) Quality(*quality);
  return camera;
}

LidarConfig Lidar(const YamlReader& reader) {
  LidarConfig lidar;
  reader.CheckKeys({"topic", "frame_id", "motion_compensated", "scan_period_s"});
  lidar.topic = Topic(reader.Child("topic"));
  lidar.frame_id = FrameId(reader.Child("frame_id"));
  if (const auto child = reader.OptionalChild("motion_compensated")) {
    lidar.motion_compensated = child->Boolean();
  }
  if (const auto child = reader.OptionalChild("scan_period_s")) {
    lidar.scan_period_s = child->Number(kScanPeriodS);
  }
  return lidar;
}

/// Names and where they were first used; an error when one is used again.
class UniqueNames {
 public:
  void Add(const std::string& name, const YamlReader& reader) {
    const auto [entry, inserted] = used_.emplace(name, reader.key());
    if (!inserted) reader.FailValue("another one than that of " + entry->second);
  }

 private:
  std::map<std::string, std::string> used_;
};

void CheckUnique(const YamlReader& root) {
  UniqueNames topics;
  UniqueNames frames;
  topics.Add(root.Child("lidar").Child("topic").String(), root.Child("lidar").Child("topic"));
  frames.Add(root.Child("lidar").Child("frame_id").String(), root.Child("lidar").Child("frame_id"));
  for (const char* sensor : {"imu", "odometry"}) {
    if (!root.Has(sensor)) continue;
    const YamlReader topic = root.Child(sensor).Child("topic");
    topics.Add(topic.String(), topic);
  }
  for (const auto& [name, camera] : root.Child("cameras").Entries()) {
    for (const char* key : {"image_topic", "camera_info_topic"}) {
      if (const auto topic = camera.OptionalChild(key)) topics.Add(topic->String(), *topic);
    }
    frames.Add(camera.Child("frame_id").String(), camera.Child("frame_id"));
  }
}

}  // namespace

Result<Rig> ParseRig(const std::string& yaml_text, const std::string& source_name) {
  YamlReader::Document document{source_name, Status::Ok()};
  const YamlReader root = YamlReader::Parse(yaml_text, &document);
  root.CheckKeys({"lidar", "imu", "odometry", "cameras", "fallback", "quality"});
  Rig rig;
  rig.lidar = Lidar(root.Child("lidar"));
  if (const auto imu = root.OptionalChild("imu")) {
    imu->CheckKeys({"topic", "lidar_from_imu"});
    rig.imu = ImuConfig{Topic(imu->Child("topic")), Transform(imu->Child("lidar_from_imu"))};
  }
  if (const auto odometry = root.OptionalChild("odometry")) {
    odometry->CheckKeys({"topic", "lidar_from_body"});
    rig.odometry = OdometryConfig{Topic(odometry->Child("topic")),
                                  Transform(odometry->Child("lidar_from_body"))};
  }
  if (const auto fallback = root.OptionalChild("fallback")) rig.fallback_file = fallback->String();
  const YamlReader cameras = root.Child("cameras");
  for (const auto& [name, camera] : cameras.Entries()) rig.cameras.push_back(Camera(name, camera));
  if (document.status.ok() && rig.cameras.empty()) cameras.Fail(" is empty, must name a camera");
  if (const auto quality = root.OptionalChild("quality")) {
    quality->CheckKeys({"accepted", "reasons"});
    quality->Child("accepted").Boolean();
    quality->Child("reasons").Strings();
  }
  if (document.status.ok()) CheckUnique(root);
  if (!document.status.ok()) return document.status;
  return rig;
}

Result<Rig> ReadRig(const std::string& path) {
  const Result<std::string> text = internal::ReadTextFile(path);
  if (!text.ok()) return text.status();
  Result<Rig> rig = ParseRig(*text, path);
  if (!rig.ok()) return rig;
  const std::filesystem::path directory = std::filesystem::path(path).parent_path();
  for (CameraConfig& camera : rig->cameras) {
    if (camera.mask_file) camera.mask_file = (directory / *camera.mask_file).string();
  }
  if (rig->fallback_file) rig->fallback_file = (directory / *rig->fallback_file).string();
  return rig;
}

Result<CalibrationResult> ReadCalibration(const std::string& path) {
  Result<Rig> rig = ReadRig(path);  // which checks everything but that there is a quality
  if (!rig.ok()) return rig.status();
  const Result<std::string> text = internal::ReadTextFile(path);
  if (!text.ok()) return text.status();
  CalibrationResult result;
  result.rig = *rig;
  YamlReader::Document document{path, Status::Ok()};
  const YamlReader root = YamlReader::Parse(*text, &document);
  const YamlReader of_rig = root.Child("quality");
  result.accepted = of_rig.Child("accepted").Boolean();
  result.reasons = of_rig.Child("reasons").Strings();
  for (const auto& [name, camera] : root.Child("cameras").Entries()) {
    result.cameras.push_back(Quality(camera.Child("quality")));
  }
  if (!document.status.ok()) return document.status;
  return result;
}

}  // namespace scenecalib
