#include "scenecalib/io/trajectory_tum.h"

#include <gtest/gtest.h>

#include "scenecalib/geometry/so3.h"
#include "testing/temporary_directory.h"

namespace scenecalib {
namespace {

std::string Error(const std::string& text) {
  const auto trajectory = ParseTrajectoryTum(text, "t.tum");
  return trajectory.ok() ? "accepted" : trajectory.status().message();
}

TEST(TrajectoryTum, ReadsStampsToTheNanosecond) {
  const auto trajectory = ParseTrajectoryTum(
      "# a comment\n1600000000.123456789 1 2 3 0 0 0.6 0.8\n\n1600000001 4 5 6 0 0 0 1\r\n",
      "t.tum");
  ASSERT_TRUE(trajectory.ok()) << trajectory.status().message();
  ASSERT_EQ(trajectory->poses().size(), 2u);
  EXPECT_EQ(trajectory->poses()[0].stamp_ns, 1600000000123456789);
  EXPECT_EQ(trajectory->poses()[1].stamp_ns, 1600000001000000000);
  EXPECT_DOUBLE_EQ(trajectory->poses()[0].map_from_lidar.rotation.z(), 0.6);
  EXPECT_DOUBLE_EQ(trajectory->poses()[0].map_from_lidar.translation.y(), 2.0);
}

TEST(TrajectoryTum, WritesWhatItReadsBackExactly) {
  std::vector<TimedPose> poses;
  for (int i = 0; i < 20; ++i) {
    poses.push_back({-500000000 + 100000001 * static_cast<Timestamp>(i),
                     Rigid3(ExpSo3({0.1 * i, 0.3, -0.2}), {1.0 / (i + 3.0), 1e-9 * i, -7.7 * i})});
  }
  const Trajectory written = Trajectory::Create(poses).value();
  const testing::TemporaryDirectory directory;
  const std::string path = directory.path() + "/t.tum";
  ASSERT_TRUE(WriteTrajectoryTum(path, written).ok());
  const auto back = ReadTrajectoryTum(path);
  ASSERT_TRUE(back.ok()) << back.status().message();
  ASSERT_EQ(back->poses().size(), poses.size());
  for (std::size_t i = 0; i < poses.size(); ++i) {
    EXPECT_EQ(back->poses()[i].stamp_ns, poses[i].stamp_ns);
    EXPECT_EQ(back->poses()[i].map_from_lidar.translation, poses[i].map_from_lidar.translation);
    EXPECT_EQ(back->poses()[i].map_from_lidar.rotation.coeffs(),
              poses[i].map_from_lidar.rotation.coeffs());
  }
}

TEST(TrajectoryTum, RefusedLinesAreNamed) {
  EXPECT_EQ(Error("1.0 1 2 3 0 0 0\n"),
            "t.tum: line 1 is '1.0 1 2 3 0 0 0', must be stamp_s x y z qx qy qz qw with a unit "
            "quaternion");
  EXPECT_NE(Error("1.0 1 2 3 0 0 0 1 9\n"), "accepted");
  EXPECT_NE(Error("1.0 1 2 x 0 0 0 1\n"), "accepted");
  EXPECT_NE(Error("1e3 1 2 3 0 0 0 1\n"), "accepted");
  EXPECT_NE(Error("1.0 1 2 3 0 0 0 2\n"), "accepted");
  EXPECT_EQ(Error("# x\n2.0 1 2 3 0 0 0 1\n1.5 1 2 3 0 0 0 1\n"),
            "t.tum: line 3: stamp 1.500000000 is not after the one before, 2.000000000");
  EXPECT_EQ(ReadTrajectoryTum("/no/such.tum").status().code(), Status::Code::kNotFound);
}

}  // namespace
}  // namespace scenecalib
