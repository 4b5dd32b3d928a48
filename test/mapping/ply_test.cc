#include "scenecalib/mapping/ply.h"

#include <gtest/gtest.h>

#include <cstring>
#include <fstream>
#include <sstream>

namespace scenecalib {
namespace {

std::string Contents(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

TriangleMesh OneTriangle() {
  TriangleMesh mesh;
  mesh.vertices_m = {{0.0F, 0.0F, 0.5F}, {1.0F, 0.0F, 0.5F}, {0.0F, 1.0F, 0.25F}};
  mesh.triangles = {{0, 1, 2}};
  return mesh;
}

TEST(WritePly, WritesAMeshAsText) {
  const std::string path = ::testing::TempDir() + "scenecalib_mesh.ply";
  ASSERT_TRUE(WritePly(path, OneTriangle(), PlyFormat::kAscii).ok());
  EXPECT_EQ(Contents(path),
            "ply\nformat ascii 1.0\ncomment map frame, metres\n"
            "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
            "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
            "0 0 0.5\n1 0 0.5\n0 1 0.25\n3 0 1 2\n");
}

TEST(WritePly, WritesAMeshInBinary) {
  const std::string path = ::testing::TempDir() + "scenecalib_mesh_binary.ply";
  ASSERT_TRUE(WritePly(path, OneTriangle(), PlyFormat::kBinary).ok());
  const std::string contents = Contents(path);
  const std::string body = contents.substr(contents.find("end_header\n") + 11);
  ASSERT_EQ(body.size(), 3u * 12u + 1u + 12u);
  float z_of_last = 0.0F;
  std::memcpy(&z_of_last, body.data() + 32, 4);
  EXPECT_EQ(z_of_last, 0.25F);
  EXPECT_EQ(body[36], 3);
}

TEST(WritePly, WritesSurfelsWithNormals) {
  Surfel surfel;
  surfel.center_m = {1.0F, 2.0F, 3.0F};
  surfel.normal = {0.0F, -1.0F, 0.0F};
  surfel.radius_m = 0.5F;
  surfel.thickness_m = 0.25F;
  surfel.scale_m = 2.0F;
  surfel.planar = false;
  const std::string path = ::testing::TempDir() + "scenecalib_surfels.ply";
  ASSERT_TRUE(WritePly(path, std::vector<Surfel>{surfel}, PlyFormat::kAscii).ok());
  const std::string contents = Contents(path);
  EXPECT_NE(contents.find("element vertex 1\n"), std::string::npos);
  EXPECT_NE(contents.find("property uchar planar\nend_header\n1 2 3 0 -1 0 0.5 0.25 2 0\n"),
            std::string::npos);
}

TEST(WritePly, NamesTheFileThatCannotBeWritten) {
  const Status status = WritePly("/nonexistent/folder/mesh.ply", OneTriangle(), PlyFormat::kAscii);
  ASSERT_FALSE(status.ok());
  EXPECT_EQ(status.code(), Status::Code::kUnavailable);
  EXPECT_NE(status.message().find("/nonexistent/folder/mesh.ply"), std::string::npos);
}

}  // namespace
}  // namespace scenecalib
