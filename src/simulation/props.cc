#include "scenecalib/simulation/props.h"

#include <Eigen/Geometry>
#include <cmath>

namespace scenecalib {

namespace {

std::uint32_t NewSurface(Mesh* mesh, Random* random, std::uint32_t object_id, Material material,
                         const Eigen::Vector3f& albedo,
                         const Eigen::Vector2f& extent_m = Eigen::Vector2f::Ones()) {
  Surface surface;
  surface.material = material;
  surface.albedo = albedo;
  surface.seed = static_cast<std::uint32_t>(random->NextBits());
  surface.extent_m = extent_m;
  surface.object_id = object_id;
  return mesh->AddSurface(surface);
}

Eigen::Vector3f RandomColour(Random* random, double low, double high) {
  const auto blue = static_cast<float>(random->Uniform(low, high));
  const auto green = static_cast<float>(random->Uniform(low, high));
  const auto red = static_cast<float>(random->Uniform(low, high));
  return {blue, green, red};
}

Eigen::Vector3d RandomInBall(Random* random) {
  for (;;) {
    const double x = random->Uniform(-1.0, 1.0);
    const double y = random->Uniform(-1.0, 1.0);
    const double z = random->Uniform(-1.0, 1.0);
    const Eigen::Vector3d p(x, y, z);
    if (p.squaredNorm() <= 1.0) return p;
  }
}

Rigid3 Upright(const Eigen::Vector3d& origin, double heading_rad) {
  return {Eigen::Quaterniond(Eigen::AngleAxisd(heading_rad, Eigen::Vector3d::UnitZ())), origin};
}

/// A box centred on x and y of the frame, standing at height z0.
void AddBlock(const Rigid3& map_from_prop, double length_m, double width_m, double z0, double z1,
              std::uint32_t surface, Mesh* mesh) {
  const Rigid3 prop_from_box(Eigen::Quaterniond::Identity(), {-0.5 * length_m, -0.5 * width_m, z0});
  mesh->AddBox(map_from_prop * prop_from_box, {length_m, width_m, z1 - z0}, surface);
}

/// An octahedron: the shadow of a cluster of leaves.
void AddBlob(const Eigen::Vector3d& middle, double radius_m, std::uint32_t surface, Mesh* mesh) {
  for (int i = 0; i < 8; ++i) {
    const Eigen::Vector3d x(((i & 1) != 0) ? radius_m : -radius_m, 0.0, 0.0);
    const Eigen::Vector3d y(0.0, ((i & 2) != 0) ? radius_m : -radius_m, 0.0);
    const Eigen::Vector3d z(0.0, 0.0, ((i & 4) != 0) ? radius_m : -radius_m);
    const Eigen::Vector3d points[3] = {middle + x, middle + y, middle + z};
    const Eigen::Vector2d uv[3] = {{0.0, 0.0}, {1.0, 0.0}, {0.0, 1.0}};
    mesh->AddTriangle(points, uv, surface);
  }
}

}  // namespace

void AddTree(const Eigen::Vector3d& foot, double height_m, int leaves_per_cluster,
             std::uint32_t object_id, Random random, Mesh* mesh, Mesh* shadow_mesh) {
  const std::uint32_t bark =
      NewSurface(mesh, &random, object_id, Material::kBark, {0.16F, 0.2F, 0.25F});
  const auto green = static_cast<float>(random.Uniform(0.8, 1.3));
  const std::uint32_t leaves = NewSurface(mesh, &random, object_id, Material::kLeaves,
                                          green * Eigen::Vector3f(0.06F, 0.22F, 0.12F));
  const double trunk_m = 0.4 * height_m;
  const double radius_m = random.Uniform(0.1, 0.2);
  const Eigen::Vector3d bend =
      foot + Eigen::Vector3d(random.Uniform(-0.15, 0.15), 0.0, 0.5 * trunk_m);
  const Eigen::Vector3d fork =
      bend + Eigen::Vector3d(0.0, random.Uniform(-0.2, 0.2), 0.5 * trunk_m);
  mesh->AddTube(foot - Eigen::Vector3d(0.0, 0.0, 0.2), bend, radius_m, 0.85 * radius_m, 9, bark);
  mesh->AddTube(bend, fork, 0.85 * radius_m, 0.7 * radius_m, 9, bark);
  const int clusters = 9 + static_cast<int>(random.Index(5));
  const double crown_m = 0.3 * height_m;
  int leaf = 0;
  for (int i = 0; i < clusters; ++i) {
    const Eigen::Vector3d offset = RandomInBall(&random);
    const Eigen::Vector3d middle = fork + Eigen::Vector3d(0.0, 0.0, 0.75 * crown_m) +
                                   crown_m * offset.cwiseProduct(Eigen::Vector3d(0.8, 0.8, 1.0));
    mesh->AddTube(fork, middle, 0.35 * radius_m, 0.1 * radius_m, 5, bark);
    const double cluster_m = random.Uniform(0.22, 0.34) * crown_m + 0.3;
    AddBlob(middle, 0.85 * cluster_m, 0, shadow_mesh);
    for (int k = 0; k < leaves_per_cluster; ++k, ++leaf) {
      // Denser outside, as light has it.
      Eigen::Vector3d at = RandomInBall(&random);
      at *= std::pow(at.norm() + 1e-9, -0.4);
      const Eigen::Vector3d centre = middle + cluster_m * at;
      const Eigen::Vector3d a = 0.2 * RandomInBall(&random);
      const Eigen::Vector3d b = 0.2 * RandomInBall(&random);
      const Eigen::Vector3d points[3] = {centre + a, centre + b, centre - 0.7 * (a + b)};
      const double cell = 16.0 * (leaf % 97) + 8.0;
      const double row = 16.0 * (leaf / 97) + 8.0;
      const Eigen::Vector2d uv[3] = {{cell, row}, {cell + 0.2, row}, {cell, row + 0.2}};
      mesh->AddTriangle(points, uv, leaves);
    }
  }
}

void AddLamp(const Eigen::Vector3d& foot, const Eigen::Vector3d& towards_road,
             std::uint32_t object_id, Random random, Mesh* mesh) {
  const std::uint32_t metal =
      NewSurface(mesh, &random, object_id, Material::kMetal, Eigen::Vector3f::Constant(0.3F));
  const double height_m = random.Uniform(5.0, 7.0);
  const Eigen::Vector3d up(0.0, 0.0, height_m);
  mesh->AddTube(foot - Eigen::Vector3d(0.0, 0.0, 0.2), foot + Eigen::Vector3d(0.0, 0.0, 1.0), 0.11,
                0.11, 10, metal);
  mesh->AddTube(foot + Eigen::Vector3d(0.0, 0.0, 1.0), foot + up, 0.07, 0.05, 8, metal);
  const Eigen::Vector3d arm = foot + up + 1.2 * towards_road + Eigen::Vector3d(0.0, 0.0, 0.2);
  mesh->AddTube(foot + up, arm, 0.04, 0.04, 6, metal);
  AddBlock(Upright(arm, std::atan2(towards_road.y(), towards_road.x())), 0.7, 0.25, -0.06, 0.06,
           metal, mesh);
}

void AddSignPost(const Eigen::Vector3d& foot, const Eigen::Vector3d& facing,
                 std::uint32_t object_id, Random random, Mesh* mesh) {
  const std::uint32_t metal =
      NewSurface(mesh, &random, object_id, Material::kMetal, Eigen::Vector3f::Constant(0.4F));
  mesh->AddTube(foot - Eigen::Vector3d(0.0, 0.0, 0.2), foot + Eigen::Vector3d(0.0, 0.0, 2.9), 0.035,
                0.035, 8, metal);
  const Rigid3 map_from_sign = Upright(foot + 0.06 * facing, std::atan2(facing.y(), facing.x()));
  const double width_m = random.Uniform(0.6, 0.9);
  const double height_m = random.Uniform(0.6, 0.9);
  const Eigen::Vector2f size(static_cast<float>(width_m), static_cast<float>(height_m));
  const Eigen::Vector3f colour = RandomColour(&random, 0.05, 0.8);
  const std::uint32_t plate = NewSurface(mesh, &random, object_id, Material::kSign, colour, size);
  AddBlock(map_from_sign, 0.03, width_m, 2.8 - height_m, 2.8, plate, mesh);
}

void AddFurniture(const Eigen::Vector3d& foot, double heading_rad, std::uint32_t object_id,
                  Random random, Mesh* mesh) {
  const Rigid3 frame = Upright(foot, heading_rad);
  const auto surface = [&](Material material, const Eigen::Vector3f& albedo) {
    return NewSurface(mesh, &random, object_id, material, albedo);
  };
  switch (random.Index(5)) {
    case 0: {  // bench
      const std::uint32_t wood = surface(Material::kBark, {0.12F, 0.2F, 0.3F});
      const std::uint32_t stone = surface(Material::kStone, Eigen::Vector3f::Constant(0.4F));
      AddBlock(frame, 1.8, 0.45, 0.42, 0.48, wood, mesh);
      for (const double x : {-0.7, 0.7}) {
        AddBlock(frame * Rigid3(Eigen::Quaterniond::Identity(), {x, 0.0, 0.0}), 0.12, 0.4, -0.1,
                 0.42, stone, mesh);
      }
      AddBlock(frame * Rigid3(Eigen::Quaterniond::Identity(), {0.0, 0.22, 0.0}), 1.8, 0.05, 0.55,
               0.9, wood, mesh);
      break;
    }
    case 1: {  // bin
      const Eigen::Vector3f colour = RandomColour(&random, 0.05, 0.4);
      AddBlock(frame, 0.45, 0.45, -0.1, 0.95, surface(Material::kMetal, colour), mesh);
      break;
    }
    case 2:  // bollard
      mesh->AddTube(foot, foot + Eigen::Vector3d(0.0, 0.0, 1.0), 0.1, 0.08, 10,
                    surface(Material::kStone, Eigen::Vector3f::Constant(0.3F)));
      break;
    case 3: {  // switch box with bills on it
      const Eigen::Vector3f colour = RandomColour(&random, 0.2, 0.6);
      const std::uint32_t box = NewSurface(mesh, &random, object_id, Material::kSign, colour,
                                           Eigen::Vector2f(0.9F, 1.2F));
      AddBlock(frame, 0.9, 0.4, -0.1, 1.3, box, mesh);
      break;
    }
    default: {  // planter
      AddBlock(frame, 1.4, 0.6, -0.1, 0.5,
               surface(Material::kStone, Eigen::Vector3f::Constant(0.45F)), mesh);
      AddBlock(frame, 1.2, 0.45, 0.5, 0.95, surface(Material::kGrass, {0.06F, 0.2F, 0.12F}), mesh);
    }
  }
}

void AddColumn(const Eigen::Vector3d& foot, double height_m, std::uint32_t object_id, Random random,
               Mesh* mesh) {
  const std::uint32_t stone =
      NewSurface(mesh, &random, object_id, Material::kStone, {0.42F, 0.47F, 0.5F});
  const Rigid3 frame = Upright(foot, random.Uniform(0.0, 1.5));
  AddBlock(frame, 0.9, 0.9, -0.2, 0.5, stone, mesh);
  mesh->AddTube(foot + Eigen::Vector3d(0.0, 0.0, 0.5),
                foot + Eigen::Vector3d(0.0, 0.0, height_m - 0.4), 0.32, 0.27, 14, stone);
  AddBlock(frame, 0.9, 0.9, height_m - 0.4, height_m, stone, mesh);
}

void AddMonument(const Eigen::Vector3d& foot, std::uint32_t object_id, Random random, Mesh* mesh) {
  const std::uint32_t stone =
      NewSurface(mesh, &random, object_id, Material::kStone, {0.38F, 0.42F, 0.46F});
  double size_m = random.Uniform(2.2, 3.2);
  double z = -0.2;
  for (int i = 0; i < 5; ++i) {
    const double top = z + random.Uniform(0.5, 1.2);
    AddBlock(Upright(foot, random.Uniform(0.0, 1.5)), size_m, size_m * random.Uniform(0.7, 1.0), z,
             top, stone, mesh);
    z = top;
    size_m *= random.Uniform(0.6, 0.85);
  }
  const std::uint32_t plate =
      NewSurface(mesh, &random, object_id, Material::kSign, Eigen::Vector3f::Constant(0.5F),
                 Eigen::Vector2f(1.2F, 0.8F));
  AddBlock(Upright(foot, 0.3), 3.3, 1.2, 0.1, 0.9, plate, mesh);
}

}  // namespace scenecalib
