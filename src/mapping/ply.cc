#include "scenecalib/mapping/ply.h"

#include <cstdint>
#include <cstring>
#include <fstream>
#include <initializer_list>
#include <limits>
#include <ostream>

namespace scenecalib {
namespace {

/// Writes the values of one element: a line of text, or their bytes (every host that this runs on
/// is little endian).
class ElementWriter {
 public:
  ElementWriter(std::ostream* out, PlyFormat format) : out_(out), format_(format) {}

  template <typename T>
  void Value(T value) {
    if (format_ == PlyFormat::kBinary) {
      char bytes[sizeof(T)];
      std::memcpy(bytes, &value, sizeof(T));
      out_->write(bytes, sizeof(T));
    } else {
      *out_ << (first_ ? "" : " ") << +value;  // + prints a byte as a number
      first_ = false;
    }
  }
  void Vector(const Eigen::Vector3f& vector) {
    for (int k = 0; k < 3; ++k) Value(vector[k]);
  }
  void EndElement() {
    if (format_ == PlyFormat::kAscii) *out_ << '\n';
    first_ = true;
  }

 private:
  std::ostream* out_;
  PlyFormat format_;
  bool first_ = true;
};

void WriteHeader(std::ostream& out, PlyFormat format) {
  out << "ply\nformat " << (format == PlyFormat::kAscii ? "ascii" : "binary_little_endian")
      << " 1.0\ncomment map frame, metres\n";
  out.precision(std::numeric_limits<float>::max_digits10);
}

void DeclareFloats(std::ostream& out, std::initializer_list<const char*> names) {
  for (const char* name : names) out << "property float " << name << '\n';
}

Status CloseChecked(std::ofstream* file, const std::string& path) {
  file->close();
  if (file->fail()) {
    return Status::Unavailable("cannot write " + path + ": check the folder and the free space");
  }
  return Status::Ok();
}

}  // namespace

Status WritePly(const std::string& path, const TriangleMesh& mesh, PlyFormat format) {
  std::ofstream file(path, std::ios::binary);
  WriteHeader(file, format);
  file << "element vertex " << mesh.vertices_m.size() << '\n';
  DeclareFloats(file, {"x", "y", "z"});
  file << "element face " << mesh.triangles.size()
       << "\nproperty list uchar int vertex_indices\nend_header\n";
  ElementWriter writer(&file, format);
  for (const Eigen::Vector3f& vertex_m : mesh.vertices_m) {
    writer.Vector(vertex_m);
    writer.EndElement();
  }
  for (const std::array<int, 3>& triangle : mesh.triangles) {
    writer.Value(std::uint8_t{3});
    for (const int vertex : triangle) writer.Value(std::int32_t{vertex});
    writer.EndElement();
  }
  return CloseChecked(&file, path);
}

Status WritePly(const std::string& path, const std::vector<Surfel>& surfels, PlyFormat format) {
  std::ofstream file(path, std::ios::binary);
  WriteHeader(file, format);
  file << "element vertex " << surfels.size() << '\n';
  DeclareFloats(file, {"x", "y", "z", "nx", "ny", "nz", "radius", "thickness", "scale"});
  file << "property uchar planar\nend_header\n";
  ElementWriter writer(&file, format);
  for (const Surfel& surfel : surfels) {
    writer.Vector(surfel.center_m);
    writer.Vector(surfel.normal);
    for (const float value : {surfel.radius_m, surfel.thickness_m, surfel.scale_m}) {
      writer.Value(value);
    }
    writer.Value(static_cast<std::uint8_t>(surfel.planar ? 1 : 0));
    writer.EndElement();
  }
  return CloseChecked(&file, path);
}

}  // namespace scenecalib
