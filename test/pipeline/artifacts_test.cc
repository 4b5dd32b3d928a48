#include "scenecalib/pipeline/artifacts.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "pipeline/one_camera_rig.h"
#include "scenecalib/io/rig_yaml.h"

namespace scenecalib {
namespace {

namespace fs = std::filesystem;

/// A result of a camera that looks along x at a wall 10 m ahead.
PipelineResult MakeResult() {
  PipelineResult result;
  const Result<Rig> rig = ParseRig(kOneCameraRig, "test");
  EXPECT_TRUE(rig.ok()) << rig.status().message();
  result.initial_rig = *rig;
  result.calibration.result.rig = *rig;
  result.calibration.result.accepted = true;
  result.calibration.result.cameras.resize(1);
  result.calibration.result.cameras[0].accepted = true;
  result.mapping.map.map_from_lidar = *Trajectory::Create({{0, Rigid3()}, {1000000000, Rigid3()}});
  for (int y = -20; y <= 20; ++y) {
    for (int z = -20; z <= 20; ++z) {
      result.mapping.map.points.push_back({Eigen::Vector3f(10.0F, 0.2F * y, 0.2F * z), 1.0F});
    }
  }
  CameraSegment segment;
  segment.num_images_in = 1;
  segment.images[500000000] = cv::Mat(48, 64, CV_8UC1, cv::Scalar(80));
  result.segments.push_back(segment);
  return result;
}

class Artifacts : public testing::Test {
 protected:
  void SetUp() override { fs::remove_all(directory_); }
  void TearDown() override { fs::remove_all(directory_); }
  static std::string Read(const fs::path& path) {
    std::ostringstream text;
    text << std::ifstream(path).rdbuf();
    return text.str();
  }
  const fs::path directory_ = fs::path(testing::TempDir()) / "scenecalib_artifacts_test";
};

TEST_F(Artifacts, WriteEveryFileOfARun) {
  const Status status = WriteArtifacts(directory_.string(), MakeResult(), "the report\n");
  ASSERT_TRUE(status.ok()) << status.message();
  EXPECT_TRUE(ReadRig((directory_ / "calibration.yaml").string()).ok());
  EXPECT_EQ(Read(directory_ / "report.txt"), "the report\n");
  EXPECT_TRUE(fs::exists(directory_ / "trajectory.tum"));
  EXPECT_TRUE(fs::exists(directory_ / "overlays" / "front_before.png"));
  EXPECT_TRUE(fs::exists(directory_ / "overlays" / "front_after.png"));
  const std::string page = Read(directory_ / "report" / "index.html");
  EXPECT_NE(page.find("</html>"), std::string::npos);
  EXPECT_NE(page.find("front, after"), std::string::npos);         // its overlay
  EXPECT_NE(page.find("all cameras, before"), std::string::npos);  // the coloured cloud
  EXPECT_FALSE(fs::exists(directory_ / ".partial"));
}

TEST_F(Artifacts, ReplaceAnEarlierResultAndLeaveOtherFilesAlone) {
  ASSERT_TRUE(WriteArtifacts(directory_.string(), MakeResult(), "first\n").ok());
  std::ofstream(directory_ / "notes.txt") << "mine";
  ASSERT_TRUE(WriteArtifacts(directory_.string(), MakeResult(), "second\n").ok());
  EXPECT_EQ(Read(directory_ / "report.txt"), "second\n");
  EXPECT_EQ(Read(directory_ / "notes.txt"), "mine");
}

TEST_F(Artifacts, KeepAnEarlierResultWhenOverlaysCannotBeDrawn) {
  ASSERT_TRUE(WriteArtifacts(directory_.string(), MakeResult(), "first\n").ok());
  PipelineResult broken = MakeResult();
  broken.segments[0].images[500000000] = cv::Mat(10, 10, CV_8UC1, cv::Scalar(80));  // wrong size
  EXPECT_FALSE(WriteArtifacts(directory_.string(), broken, "second\n").ok());
  EXPECT_EQ(Read(directory_ / "report.txt"), "first\n");
  EXPECT_FALSE(fs::exists(directory_ / ".partial"));
}

TEST_F(Artifacts, SayWhereTheyCannotBeWritten) {
  std::ofstream(directory_.string()) << "a file, not a directory";
  const Status status = WriteArtifacts(directory_.string(), MakeResult(), "report\n");
  EXPECT_EQ(status.code(), Status::Code::kUnavailable);
  EXPECT_NE(status.message().find("scenecalib_artifacts_test"), std::string::npos);
}

}  // namespace
}  // namespace scenecalib
