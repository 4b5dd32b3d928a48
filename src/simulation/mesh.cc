#include "scenecalib/simulation/mesh.h"

#include <Eigen/Geometry>
#include <cmath>

namespace scenecalib {

namespace {

/// Gradient in space of a function that is linear on the triangle and constant across it.
Eigen::Vector3d LinearGradient(const Eigen::Vector3d& edge1, const Eigen::Vector3d& edge2,
                               double change1, double change2) {
  const double a = edge1.squaredNorm();
  const double b = edge1.dot(edge2);
  const double c = edge2.squaredNorm();
  const double determinant = a * c - b * b;
  if (determinant <= 1e-18) return Eigen::Vector3d::Zero();
  return ((c * change1 - b * change2) * edge1 + (a * change2 - b * change1) * edge2) / determinant;
}

}  // namespace

std::uint32_t Mesh::AddSurface(const Surface& surface) {
  surfaces_.push_back(surface);
  return static_cast<std::uint32_t>(surfaces_.size() - 1);
}

void Mesh::AddTriangle(const Eigen::Vector3d points[3], const Eigen::Vector2d uv[3],
                       std::uint32_t surface) {
  const Eigen::Vector3d edge1 = points[1] - points[0];
  const Eigen::Vector3d edge2 = points[2] - points[0];
  if (edge1.cross(edge2).squaredNorm() < 1e-16) return;  // nothing to see
  TriangleTexture texture;
  texture.surface = surface;
  for (int i = 0; i < 3; ++i) {
    vertices_.push_back(points[i].cast<float>());
    texture.uv[i] = uv[i].cast<float>();
  }
  const Eigen::Vector2d change1 = uv[1] - uv[0];
  const Eigen::Vector2d change2 = uv[2] - uv[0];
  texture.u_gradient = LinearGradient(edge1, edge2, change1.x(), change2.x()).cast<float>();
  texture.v_gradient = LinearGradient(edge1, edge2, change1.y(), change2.y()).cast<float>();
  textures_.push_back(texture);
}

void Mesh::AddQuad(const Eigen::Vector3d& p0, const Eigen::Vector3d& p1, const Eigen::Vector3d& p2,
                   const Eigen::Vector3d& p3, const Eigen::Vector2d& uv0,
                   const Eigen::Vector2d& uv1, const Eigen::Vector2d& uv2,
                   const Eigen::Vector2d& uv3, std::uint32_t surface) {
  const Eigen::Vector3d first[3] = {p0, p1, p2};
  const Eigen::Vector2d first_uv[3] = {uv0, uv1, uv2};
  const Eigen::Vector3d second[3] = {p0, p2, p3};
  const Eigen::Vector2d second_uv[3] = {uv0, uv2, uv3};
  AddTriangle(first, first_uv, surface);
  AddTriangle(second, second_uv, surface);
}

void Mesh::AddPatch(const Eigen::Vector3d& corner, const Eigen::Vector3d& edge_u,
                    const Eigen::Vector3d& edge_v, const Eigen::Vector2d& uv_corner,
                    std::uint32_t surface) {
  const Eigen::Vector2d u(edge_u.norm(), 0.0);
  const Eigen::Vector2d v(0.0, edge_v.norm());
  AddQuad(corner, corner + edge_u, corner + edge_u + edge_v, corner + edge_v, uv_corner,
          uv_corner + u, uv_corner + u + v, uv_corner + v, surface);
}

void Mesh::AddBox(const Rigid3& world_from_box, const Eigen::Vector3d& size_m,
                  std::uint32_t surface) {
  const Eigen::Vector3d origin = world_from_box.translation;
  const Eigen::Vector3d x = world_from_box.rotation * Eigen::Vector3d(size_m.x(), 0.0, 0.0);
  const Eigen::Vector3d y = world_from_box.rotation * Eigen::Vector3d(0.0, size_m.y(), 0.0);
  const Eigen::Vector3d z = world_from_box.rotation * Eigen::Vector3d(0.0, 0.0, size_m.z());
  // Far apart in texture space, so that no two faces look alike.
  AddPatch(origin, x, z, {0.0, 0.0}, surface);
  AddPatch(origin + y, x, z, {31.0, 0.0}, surface);
  AddPatch(origin, y, z, {0.0, 37.0}, surface);
  AddPatch(origin + x, y, z, {31.0, 37.0}, surface);
  AddPatch(origin, x, y, {67.0, 0.0}, surface);
  AddPatch(origin + z, x, y, {67.0, 37.0}, surface);
}

void Mesh::AddTube(const Eigen::Vector3d& bottom, const Eigen::Vector3d& top,
                   double bottom_radius_m, double top_radius_m, int sides, std::uint32_t surface) {
  const Eigen::Vector3d axis = (top - bottom).normalized();
  const Eigen::Vector3d x =
      axis.cross(std::abs(axis.z()) < 0.9 ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitX())
          .normalized();
  const Eigen::Vector3d y = axis.cross(x);
  const double length_m = (top - bottom).norm();
  const double step_rad = 2.0 * M_PI / sides;
  for (int i = 0; i < sides; ++i) {
    const auto ring = [&](int k) {
      return Eigen::Vector3d(std::cos(k * step_rad) * x + std::sin(k * step_rad) * y);
    };
    const double u0 = i * step_rad * bottom_radius_m;
    const double u1 = (i + 1) * step_rad * bottom_radius_m;
    AddQuad(bottom + bottom_radius_m * ring(i), bottom + bottom_radius_m * ring(i + 1),
            top + top_radius_m * ring(i + 1), top + top_radius_m * ring(i), {u0, 0.0}, {u1, 0.0},
            {u1, length_m}, {u0, length_m}, surface);
  }
}

}  // namespace scenecalib
