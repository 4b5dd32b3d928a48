#include "scenecalib/io/rig_yaml.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstdio>
#include <fstream>
#include <limits>
#include <sstream>
#include <string>

#include "scenecalib/sensor/camera_factory.h"
#include "testing/temporary_directory.h"

namespace scenecalib {
namespace {

const char* const kRig = R"(lidar: {topic: /lidar/points, frame_id: lidar}
imu:
  topic: /imu/data
  lidar_from_imu:
    translation_m: [-0.25, 0.1, -1.5]
    rotation_xyzw: [0.0, 0.0, 0.6, 0.8]
odometry:
  topic: /odom
  lidar_from_body:
    translation_m: [-0.9, 0.0, -1.9]
    rotation_xyzw: [0, 0, 0, 1]
cameras:
  zebra:   # the file's order is kept, not the alphabet's
    image_topic: /zebra/image_raw/compressed
    frame_id: zebra_optical
    lidar_from_camera:
      translation_m: [0.5, 0.07, -0.3]
      rotation_xyzw: [-0.5, 0.5, -0.5, 0.5]
    intrinsics:
      model: plumb_bob
      width_px: 640
      height_px: 480
      focal_px: [500.25, 501.5]
      principal_point_px: [320.1, 238.9]
      distortion: [-0.05, 0.02, 0.0004, -0.0003, 0.0]
  fisheye:
    image_topic: /fisheye/image_raw
    frame_id: fisheye_optical
    time_offset_s: -0.0125
    mask: masks/fisheye.png
    rolling_shutter_line_time_s: 0.00002
    lidar_from_camera: {translation_m: [2.7, 0.0, -1.2], rotation_xyzw: [-0.5, 0.5, -0.5, 0.5]}
    intrinsics:
      model: ftheta
      width_px: 1280
      height_px: 720
      principal_point_px: [641.5, 355.5]
      polynomial_px: [388.0, 2.5, -8.5, 1.1, 0.0]
  later:
    image_topic: /later/image_raw
    camera_info_topic: /later/camera_info
    frame_id: later_optical
    lidar_from_camera: {translation_m: [0, 1, 0], rotation_xyzw: [0, 0, 0, 1]}
)";

std::string Replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << "the fixture has no '" << from << "'";
  if (at != std::string::npos) text.replace(at, from.size(), to);
  return text;
}

/// What ParseRig says about the fixture with one text replaced.
std::string ErrorAfter(const std::string& from, const std::string& to) {
  const Result<Rig> rig = ParseRig(Replaced(kRig, from, to), "rig.yaml");
  return rig.ok() ? "accepted" : rig.status().message();
}

std::string Read(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

CalibrationResult ExampleResult() {
  CalibrationResult result;
  result.rig = *ParseRig(kRig, "rig.yaml");
  result.accepted = false;
  result.reasons = {"camera \"later\": 3 tracks\nare too few"};
  result.cameras.resize(3);
  CameraQuality& quality = result.cameras[0];
  quality.accepted = true;
  quality.num_tracks = 1200;
  quality.num_inlier_tracks = 1100;
  quality.rms_before_px = 7.25;
  quality.rms_after_px = 1.0 / 3.0;
  quality.stddev.rotation_rad = {1e-5, 2e-5, 3e-5};
  quality.stddev.time_offset_s = std::numeric_limits<double>::infinity();
  quality.miscalibration_rate_after = MiscalibrationRate{0.1, 0.2, 0.3, 0.4, 0.5, 0.6};
  return result;
}

TEST(RigYaml, ReadsEverySensorInTheFilesOrder) {
  const Result<Rig> rig = ParseRig(kRig, "rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status().message();
  EXPECT_EQ(rig->lidar.topic, "/lidar/points");
  EXPECT_EQ(rig->lidar.frame_id, "lidar");
  EXPECT_FALSE(rig->lidar.motion_compensated);
  EXPECT_FALSE(rig->lidar.scan_period_s.has_value());
  ASSERT_TRUE(rig->imu.has_value());
  EXPECT_EQ(rig->imu->topic, "/imu/data");
  EXPECT_DOUBLE_EQ(rig->imu->lidar_from_imu.rotation.z(), 0.6);
  ASSERT_TRUE(rig->odometry.has_value());
  EXPECT_DOUBLE_EQ(rig->odometry->lidar_from_body.translation.z(), -1.9);
  ASSERT_EQ(rig->cameras.size(), 3u);
  EXPECT_EQ(rig->cameras[0].name, "zebra");
  EXPECT_EQ(rig->cameras[1].name, "fisheye");
  EXPECT_EQ(rig->cameras[2].name, "later");
  EXPECT_DOUBLE_EQ(rig->cameras[0].lidar_from_camera.rotation.x(), -0.5);
  EXPECT_DOUBLE_EQ(rig->cameras[0].lidar_from_camera.rotation.w(), 0.5);
  EXPECT_DOUBLE_EQ(rig->cameras[1].time_offset_s, -0.0125);
  ASSERT_NE(rig->cameras[1].model, nullptr);
  EXPECT_EQ(rig->cameras[1].model->name(), "ftheta");
  EXPECT_EQ(rig->cameras[2].model, nullptr);
  EXPECT_EQ(rig->cameras[2].camera_info_topic, "/later/camera_info");
  EXPECT_EQ(rig->cameras[1].mask_file, "masks/fisheye.png");
  EXPECT_EQ(rig->cameras[1].rolling_shutter_line_time_s, 2e-5);
  EXPECT_FALSE(rig->cameras[0].mask_file);
  EXPECT_FALSE(rig->cameras[0].rolling_shutter_line_time_s);
}

TEST(RigYaml, ReadsTheOptionalKeysOfTheLidar) {
  const Result<Rig> rig =
      ParseRig(Replaced(kRig, "frame_id: lidar}",
                        "frame_id: lidar, motion_compensated: true, scan_period_s: 0.05}"),
               "rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status().message();
  EXPECT_TRUE(rig->lidar.motion_compensated);
  EXPECT_DOUBLE_EQ(rig->lidar.scan_period_s.value(), 0.05);
}

TEST(RigYaml, ReadsAndWritesTheInitialTolerances) {
  const std::string tolerances =
      "frame_id: zebra_optical\n    initial_stddev: {translation_m: [0.1, 0.2, 0.3], "
      "principal_point_px: [2, 3.5], focal_scale: 0.001}";
  const Result<Rig> rig =
      ParseRig(Replaced(kRig, "frame_id: zebra_optical", tolerances), "rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status().message();
  const Result<Rig> back = ParseRig(FormatRig(*rig), "written.yaml");
  ASSERT_TRUE(back.ok()) << back.status().message();
  for (const Rig* read : {&*rig, &*back}) {
    const InitialStddev& stddev = read->cameras[0].initial_stddev;
    EXPECT_EQ(stddev.translation_m.value(), Eigen::Vector3d(0.1, 0.2, 0.3));
    EXPECT_EQ(stddev.principal_point_px.value(), Eigen::Vector2d(2.0, 3.5));
    EXPECT_DOUBLE_EQ(stddev.focal_scale.value(), 0.001);
    EXPECT_FALSE(stddev.rotation_rad || stddev.time_offset_s);
  }
  EXPECT_EQ(ErrorAfter("frame_id: zebra_optical",
                       "frame_id: zebra_optical\n    initial_stddev: {focal_scale: 0}"),
            "rig.yaml: cameras.zebra.initial_stddev.focal_scale is '0', must be a number in "
            "[1e-07, 1]");
}

TEST(RigYaml, MasksLieWhereTheRigFileLies) {
  const testing::TemporaryDirectory directory;
  const std::string path = directory.path() + "/rig.yaml";
  std::ofstream(path) << kRig;
  const Result<Rig> rig = ReadRig(path);
  ASSERT_TRUE(rig.ok()) << rig.status().message();
  EXPECT_EQ(rig->cameras[1].mask_file, directory.path() + "/masks/fisheye.png");
  const Result<Rig> again = ParseRig(FormatRig(*rig), "again.yaml");
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(again->cameras[1].mask_file, rig->cameras[1].mask_file);
  EXPECT_EQ(again->cameras[1].rolling_shutter_line_time_s, 2e-5);
}

TEST(RigYaml, TheFallbackLiesWhereTheRigFileLies) {
  const testing::TemporaryDirectory directory;
  const std::string path = directory.path() + "/rig.yaml";
  std::ofstream(path) << kRig << "\nfallback: earlier/calibration.yaml\n";
  const Result<Rig> rig = ReadRig(path);
  ASSERT_TRUE(rig.ok()) << rig.status().message();
  EXPECT_EQ(rig->fallback_file, directory.path() + "/earlier/calibration.yaml");
  const Result<Rig> again = ParseRig(FormatRig(*rig), "again.yaml");
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(again->fallback_file, rig->fallback_file);
}

TEST(RigYaml, ACalibrationReadsBackWithItsQuality) {
  const testing::TemporaryDirectory directory;
  const std::string path = directory.path() + "/calibration.yaml";
  CalibrationResult written = ExampleResult();
  for (CameraConfig& camera : written.rig.cameras) camera.mask_file.reset();  // moves on reading
  ASSERT_TRUE(WriteCalibration(path, written).ok());
  const Result<CalibrationResult> read = ReadCalibration(path);
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(FormatCalibration(*read), FormatCalibration(written));
}

TEST(RigYaml, ARigWithoutQualityIsNoCalibration) {
  const testing::TemporaryDirectory directory;
  const std::string path = directory.path() + "/rig.yaml";
  std::ofstream(path) << kRig;
  const Result<CalibrationResult> read = ReadCalibration(path);
  EXPECT_EQ(read.status().code(), Status::Code::kInvalidArgument);
  EXPECT_NE(read.status().message().find("quality"), std::string::npos);
}

TEST(RigYaml, LineTimesOutOfTheirBoundAreNamed) {
  EXPECT_NE(ErrorAfter("rolling_shutter_line_time_s: 0.00002", "rolling_shutter_line_time_s: 0.5")
                .find("cameras.fisheye.rolling_shutter_line_time_s"),
            std::string::npos);
}

TEST(RigYaml, WritesWhatItReadsBackExactly) {
  const Result<Rig> rig = ParseRig(kRig, "rig.yaml");
  ASSERT_TRUE(rig.ok());
  Rig awkward = *rig;
  awkward.cameras[0].name = "on: off #1 \"x\"";
  awkward.cameras[1].name = "null";
  awkward.cameras[0].lidar_from_camera.rotation = Eigen::Quaterniond(0.3, 0.1, -0.7, 0.2);
  awkward.cameras[0].lidar_from_camera.rotation.normalize();
  awkward.cameras[0].lidar_from_camera.translation = {1.0 / 3.0, -1e-17, 0.1 + 0.2};
  const std::string text = FormatRig(awkward);
  const Result<Rig> back = ParseRig(text, "written.yaml");
  ASSERT_TRUE(back.ok()) << back.status().message() << "\n" << text;
  EXPECT_EQ(back->cameras[0].name, awkward.cameras[0].name);
  EXPECT_EQ(back->cameras[1].name, "null");
  EXPECT_EQ(back->cameras[0].lidar_from_camera.translation,
            awkward.cameras[0].lidar_from_camera.translation);
  EXPECT_EQ(back->cameras[0].lidar_from_camera.rotation.coeffs(),
            awkward.cameras[0].lidar_from_camera.rotation.coeffs());
  EXPECT_EQ(FormatRig(*back), text);
}

TEST(RigYaml, ACalibrationIsTheNextRunsRig) {
  const CalibrationResult result = ExampleResult();
  const std::string text = FormatCalibration(result);
  const Result<Rig> rig = ParseRig(text, "calibration.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status().message() << "\n" << text;
  EXPECT_EQ(FormatRig(*rig), FormatRig(result.rig));
  EXPECT_NE(text.find("accepted: false"), std::string::npos);
  EXPECT_NE(text.find("rms_after_px: 0.3333333333333333\n"), std::string::npos);
  EXPECT_NE(text.find("miscalibration_rate_after: {x: 0.1, y: 0.2"), std::string::npos);
  EXPECT_EQ(text.find("miscalibration_rate_before"), std::string::npos);
}

TEST(RigYaml, QualityBlocksAreCheckedForTheirForm) {
  const std::string text = FormatCalibration(ExampleResult());
  const auto error = [&text](const std::string& from, const std::string& to) {
    const Result<Rig> rig = ParseRig(Replaced(text, from, to), "c.yaml");
    return rig.ok() ? "accepted" : rig.status().message();
  };
  EXPECT_EQ(error("num_tracks: 1200", "num_tracks: -1"),
            "c.yaml: cameras.zebra.quality.num_tracks is '-1', must be an integer in "
            "[0, 2147483647]");
  EXPECT_EQ(error("accepted: true", "accepted: 1"),
            "c.yaml: cameras.zebra.quality.accepted is '1', must be true or false");
  EXPECT_EQ(error("yaw: 0.6}", "yaw: 0.6, w: 1}").substr(0, 74),
            "c.yaml: cameras.zebra.quality.miscalibration_rate_after.w is an unknown ke");
}

TEST(RigYaml, UnknownKeysAreNamedWithTheirValue) {
  EXPECT_EQ(ErrorAfter("width_px: 640", "width_px: 640\n      witdh_px: 641"),
            "rig.yaml: cameras.zebra.intrinsics.witdh_px is an unknown key (its value is '641'); "
            "known here: model, width_px, height_px, principal_point_px, focal_px, distortion");
  EXPECT_EQ(ErrorAfter("lidar: {", "radar: {}\nlidar: {"),
            "rig.yaml: radar is an unknown key (its value is a map); known here: lidar, imu, "
            "odometry, cameras, fallback, quality");
  EXPECT_NE(ErrorAfter("time_offset_s:", "time_offset:").find("cameras.fisheye.time_offset is"),
            std::string::npos);
  // The keys of another model are unknown here.
  EXPECT_NE(ErrorAfter("polynomial_px:", "focal_px: [1, 1]\n      polynomial_px:")
                .find("cameras.fisheye.intrinsics.focal_px is an unknown key"),
            std::string::npos);
}

TEST(RigYaml, MissingKeysAreNamed) {
  EXPECT_EQ(ErrorAfter("    frame_id: zebra_optical\n", ""),
            "rig.yaml: cameras.zebra.frame_id is missing");
  EXPECT_EQ(ErrorAfter("{topic: /lidar/points, frame_id: lidar}", "{topic: /lidar/points}"),
            "rig.yaml: lidar.frame_id is missing");
  EXPECT_EQ(ErrorAfter("      width_px: 640\n", ""),
            "rig.yaml: cameras.zebra.intrinsics.width_px is missing");
  EXPECT_EQ(ErrorAfter("    camera_info_topic: /later/camera_info\n", ""),
            "rig.yaml: cameras.later.intrinsics is missing, and there is no camera_info_topic to "
            "take them from");
  EXPECT_EQ(ParseRig("lidar: {topic: /l, frame_id: l}\n", "r.yaml").status().message(),
            "r.yaml: cameras is missing");
  EXPECT_EQ(ParseRig("lidar: {topic: /l, frame_id: l}\ncameras: {}\n", "r.yaml").status().message(),
            "r.yaml: cameras is empty, must name a camera");
  EXPECT_EQ(ParseRig("", "r.yaml").status().message(), "r.yaml: the file is empty, must be a map");
}

TEST(RigYaml, MistypedValuesAreNamed) {
  EXPECT_EQ(ErrorAfter("time_offset_s: -0.0125", "time_offset_s: soon"),
            "rig.yaml: cameras.fisheye.time_offset_s is 'soon', must be a number in "
            "[-3600, 3600]");
  EXPECT_EQ(ErrorAfter("width_px: 640", "width_px: 640.5"),
            "rig.yaml: cameras.zebra.intrinsics.width_px is '640.5', must be an integer in "
            "[1, 65536]");
  EXPECT_EQ(ErrorAfter("width_px: 640", "width_px: \"640\""),
            "rig.yaml: cameras.zebra.intrinsics.width_px is '640', must be an integer in "
            "[1, 65536]");
  EXPECT_EQ(ErrorAfter("[320.1, 238.9]", "[320.1]"),
            "rig.yaml: cameras.zebra.intrinsics.principal_point_px is a list of 1, must be a list "
            "of 2 numbers");
  EXPECT_EQ(ErrorAfter("[320.1, 238.9]", "[320.1, .nan]"),
            "rig.yaml: cameras.zebra.intrinsics.principal_point_px[1] is '.nan', must be a number");
  EXPECT_EQ(ErrorAfter("frame_id: zebra_optical", "frame_id: [zebra]"),
            "rig.yaml: cameras.zebra.frame_id is a list of 1, must be a text");
  EXPECT_EQ(ErrorAfter("frame_id: lidar}", "frame_id: lidar, motion_compensated: 2}"),
            "rig.yaml: lidar.motion_compensated is '2', must be true or false");
  EXPECT_EQ(ErrorAfter("imu:\n  topic: /imu/data\n", "imu:\n"), "rig.yaml: imu.topic is missing");
  EXPECT_EQ(ParseRig("- lidar\n", "r.yaml").status().message(),
            "r.yaml: the file is a list of 1, must be a map");
}

TEST(RigYaml, ValuesOutOfTheirBoundAreNamedWithIt) {
  EXPECT_EQ(ErrorAfter("[0.5, 0.07, -0.3]", "[0.5, 700.0, -0.3]"),
            "rig.yaml: cameras.zebra.lidar_from_camera.translation_m[1] is '700.0', must be a "
            "number in [-100, 100]");
  EXPECT_EQ(ErrorAfter("frame_id: lidar}", "frame_id: lidar, scan_period_s: 100}"),
            "rig.yaml: lidar.scan_period_s is '100', must be a number in [0.001, 10]");
  EXPECT_EQ(ErrorAfter("height_px: 480", "height_px: 0"),
            "rig.yaml: cameras.zebra.intrinsics.height_px is '0', must be an integer in "
            "[1, 65536]");
  EXPECT_EQ(ErrorAfter("[500.25, 501.5]", "[500.25, -501.5]"),
            "rig.yaml: cameras.zebra.intrinsics.focal_px[1] is '-501.5', must be a number in "
            "[0.001, 100000]");
  EXPECT_EQ(ErrorAfter("model: ftheta", "model: ocam"),
            "rig.yaml: cameras.fisheye.intrinsics.model is 'ocam', must be ftheta, plumb_bob, "
            "rational_polynomial or equidistant");
  EXPECT_EQ(ErrorAfter("/imu/data", "/imu data"),
            "rig.yaml: imu.topic is '/imu data', must be a ROS topic (letters, digits, _ and /)");
  EXPECT_EQ(ErrorAfter("frame_id: zebra_optical", "frame_id: /zebra"),
            "rig.yaml: cameras.zebra.frame_id is '/zebra', must be a tf2 frame (no leading slash, "
            "no space)");
}

TEST(RigYaml, LensesThatFoldInsideTheImageAreRefusedByName) {
  const std::string error = ErrorAfter("[388.0, 2.5, -8.5, 1.1, 0.0]", "[400, 0, -100, 0, 0]");
  EXPECT_EQ(
      error.substr(0, 88),
      "rig.yaml: cameras.fisheye.intrinsics: ftheta: polynomial_px stops being monotonic at 66.");
}

TEST(RigYaml, QuaternionsMustBeUnitAndAreNormalised) {
  EXPECT_EQ(ErrorAfter("[0.0, 0.0, 0.6, 0.8]", "[0, 0, 0.6, 0.9]"),
            "rig.yaml: imu.lidar_from_imu.rotation_xyzw is [0, 0, 0.6, 0.9] with norm "
            "1.0816653826391966, must be a unit quaternion x, y, z, w (norm within 0.001 of 1)");
  EXPECT_NE(ErrorAfter("[0.0, 0.0, 0.6, 0.8]", "[0, 0, 0, 0]"), "accepted");
  const Result<Rig> rig =
      ParseRig(Replaced(kRig, "[0.0, 0.0, 0.6, 0.8]", "[0, 0, 0.6004, 0.8]"), "rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status().message();
  EXPECT_NEAR(rig->imu->lidar_from_imu.rotation.norm(), 1.0, 1e-15);
}

TEST(RigYaml, TopicsAndFramesOfTwoSensorsMustDiffer) {
  EXPECT_EQ(ErrorAfter("/fisheye/image_raw", "/zebra/image_raw/compressed"),
            "rig.yaml: cameras.fisheye.image_topic is '/zebra/image_raw/compressed', must be "
            "another one than that of cameras.zebra.image_topic");
  EXPECT_EQ(ErrorAfter("frame_id: fisheye_optical", "frame_id: zebra_optical"),
            "rig.yaml: cameras.fisheye.frame_id is 'zebra_optical', must be another one than that "
            "of cameras.zebra.frame_id");
  EXPECT_EQ(ErrorAfter("frame_id: zebra_optical", "frame_id: lidar"),
            "rig.yaml: cameras.zebra.frame_id is 'lidar', must be another one than that of "
            "lidar.frame_id");
  EXPECT_EQ(ErrorAfter("topic: /odom", "topic: /imu/data"),
            "rig.yaml: odometry.topic is '/imu/data', must be another one than that of imu.topic");
}

TEST(RigYaml, KeysGivenTwiceAndBadNamesAreRefused) {
  EXPECT_EQ(ErrorAfter("  fisheye:", "  zebra:"), "rig.yaml: cameras.zebra is given twice");
  EXPECT_EQ(ErrorAfter("height_px: 480", "height_px: 480\n      height_px: 481"),
            "rig.yaml: cameras.zebra.intrinsics.height_px is given twice");
  EXPECT_NE(ErrorAfter("  fisheye:", "  ../fisheye:").find("cannot be a file name"),
            std::string::npos);
}

TEST(RigYaml, BrokenYamlIsNamedWithItsLine) {
  const std::string error = ErrorAfter("imu:\n", "imu: [\n");
  EXPECT_EQ(error.substr(0, 31), "rig.yaml: not valid YAML: line ") << error;
}

TEST(RigYaml, FilesThatCannotBeReadAreNamed) {
  const Result<Rig> missing = ReadRig("/no/such/rig.yaml");
  EXPECT_EQ(missing.status().code(), Status::Code::kNotFound);
  EXPECT_EQ(missing.status().message().substr(0, 17), "/no/such/rig.yaml");
  const testing::TemporaryDirectory directory;
  EXPECT_FALSE(ReadRig(directory.path()).ok());  // a folder
}

TEST(RigYaml, WritingReplacesTheFileAndLeavesNothingElse) {
  const testing::TemporaryDirectory directory;
  const std::string path = directory.path() + "/calibration.yaml";
  ASSERT_TRUE(WriteRig(path, ExampleResult().rig).ok());
  EXPECT_EQ(Read(path), FormatRig(ExampleResult().rig));
  ASSERT_TRUE(WriteCalibration(path, ExampleResult()).ok());
  EXPECT_EQ(Read(path), FormatCalibration(ExampleResult()));
  EXPECT_EQ(directory.FileNames(), std::vector<std::string>{"calibration.yaml"});
  const Result<Rig> back = ReadRig(path);
  ASSERT_TRUE(back.ok()) << back.status().message();
  EXPECT_EQ(back->cameras.size(), 3u);
}

TEST(RigYaml, AFailedWriteLeavesTheEarlierResult) {
  const testing::TemporaryDirectory directory;
  // A folder in the place of the file: the rename fails after everything was written.
  const std::string path = directory.path() + "/calibration.yaml";
  ASSERT_EQ(::mkdir(path.c_str(), 0777), 0);
  const Status status = WriteRig(path, ExampleResult().rig);
  EXPECT_EQ(status.code(), Status::Code::kUnavailable);
  EXPECT_EQ(status.message().substr(0, path.size()), path);
  EXPECT_EQ(directory.FileNames(), std::vector<std::string>{"calibration.yaml"});
  EXPECT_EQ(WriteRig("/no/such/folder/rig.yaml", ExampleResult().rig).code(),
            Status::Code::kUnavailable);
}

}  // namespace
}  // namespace scenecalib
