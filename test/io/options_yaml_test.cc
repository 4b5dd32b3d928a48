#include "scenecalib/io/options_yaml.h"

#include <gtest/gtest.h>

#include <fstream>
#include <string>

#include "testing/temporary_directory.h"

namespace scenecalib {
namespace {

struct VoxelOptions {
  double voxel_size_m = 0.5;
  int max_points = 20;
  void Visit(OptionVisitor& v) {
    v.Field("voxel_size_m", &voxel_size_m, {0.05, 5.0}, "edge of a voxel");
    v.Field("max_points", &max_points, {1, 100}, "points kept per voxel");
  }
};

struct MapperOptions {
  std::string method = "gicp";
  bool use_imu = true;
  VoxelOptions voxels;
  void Visit(OptionVisitor& v) {
    v.Field("method", &method, "registration");
    v.Field("use_imu", &use_imu, "prior from the IMU");
    v.Group("voxels", &voxels);
  }
};

class OptionsYaml : public ::testing::Test {
 protected:
  Status Apply(const std::string& text) {
    std::ofstream(path_) << text;
    return ReadOptionsYaml(path_, &options_);
  }
  /// The message without the folder.
  std::string Error(const std::string& text) {
    const std::string message = Apply(text).message();
    return message.empty() ? "accepted" : message.substr(directory_.path().size() + 1);
  }

  testing::TemporaryDirectory directory_;
  std::string path_ = directory_.path() + "/o.yaml";
  MapperOptions options_;
};

TEST_F(OptionsYaml, OverwritesTheNamedFieldsOnly) {
  const Status status = Apply("use_imu: false\nvoxels: {max_points: 7}\n");
  ASSERT_TRUE(status.ok()) << status.message();
  EXPECT_FALSE(options_.use_imu);
  EXPECT_EQ(options_.voxels.max_points, 7);
  EXPECT_DOUBLE_EQ(options_.voxels.voxel_size_m, 0.5);
  EXPECT_EQ(options_.method, "gicp");
}

TEST_F(OptionsYaml, AnEmptyFileChangesNothing) {
  EXPECT_TRUE(Apply("# nothing yet\n").ok());
  EXPECT_TRUE(Apply("").ok());
  EXPECT_EQ(options_.voxels.max_points, 20);
}

TEST_F(OptionsYaml, IntegersAreNumbersToo) {
  EXPECT_TRUE(Apply("voxels: {voxel_size_m: 2}").ok());
  EXPECT_DOUBLE_EQ(options_.voxels.voxel_size_m, 2.0);
}

TEST_F(OptionsYaml, NamesFileKeyValueAndBoundOfWhatItRefuses) {
  EXPECT_EQ(Error("voxels: {max_points: 101}"),
            "o.yaml: voxels.max_points is '101', must be an integer in [1, 100]");
  EXPECT_EQ(Error("voxels: {max_points: 7.0}"),
            "o.yaml: voxels.max_points is '7.0', must be an integer in [1, 100]");
  EXPECT_EQ(Error("voxels: {voxel_size_m: big}"),
            "o.yaml: voxels.voxel_size_m is 'big', must be a number in [0.05, 5]");
  EXPECT_EQ(Error("voxels: {voxel_size_m: .inf}"),
            "o.yaml: voxels.voxel_size_m is '.inf', must be a number in [0.05, 5]");
  EXPECT_EQ(Error("use_imu: maybe"), "o.yaml: use_imu is 'maybe', must be true or false");
  EXPECT_EQ(Error("method: [a]"), "o.yaml: method is a list of 1, must be a text");
  EXPECT_EQ(Error("voxels: 3"), "o.yaml: voxels is '3', must be a map");
  EXPECT_EQ(Error("voxel: {}"),
            "o.yaml: voxel is an unknown key (its value is a map); known here: method, use_imu, "
            "voxels");
  EXPECT_EQ(Error("voxels: {size: 3}"),
            "o.yaml: voxels.size is an unknown key (its value is '3'); known here: voxel_size_m, "
            "max_points");
  EXPECT_EQ(Error("- a"), "o.yaml: the file is a list of 1, must be a map");
}

TEST_F(OptionsYaml, ARefusedFileLeavesTheOptionsUnchanged) {
  EXPECT_FALSE(Apply("method: icp\nvoxels: {max_points: 0}").ok());
  EXPECT_EQ(options_.method, "gicp");
  EXPECT_EQ(options_.voxels.max_points, 20);
}

TEST_F(OptionsYaml, AMissingFileIsNamed) {
  const Status status = ReadOptionsYaml("/no/such/o.yaml", &options_);
  EXPECT_EQ(status.code(), Status::Code::kNotFound);
  EXPECT_EQ(status.message(), "/no/such/o.yaml: cannot be opened: No such file or directory");
}

}  // namespace
}  // namespace scenecalib
