#include "scenecalib/simulation/yard.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "wall_frame.h"

namespace scenecalib {

namespace {

/// Makes surfaces of one object.
class Painter {
 public:
  Painter(std::uint32_t object_id, Random random, Mesh* mesh)
      : object_id_(object_id), random_(random), mesh_(mesh) {}

  Random& random() { return random_; }
  Mesh* mesh() { return mesh_; }

  std::uint32_t NewSurface(Material material, const Eigen::Vector3f& albedo,
                           const Eigen::Vector2f& extent_m = Eigen::Vector2f::Ones()) {
    Surface surface;
    surface.material = material;
    surface.albedo = albedo;
    surface.seed = static_cast<std::uint32_t>(random_.NextBits());
    surface.extent_m = extent_m;
    surface.object_id = object_id_;
    return mesh_->AddSurface(surface);
  }

  /// A rectangle on the wall.
  void AddRectangle(const WallFrame& wall, const Eigen::Vector2d& low, const Eigen::Vector2d& high,
                    std::uint32_t surface) {
    mesh_->AddPatch(wall.At(low.x(), low.y(), 0.0), (high.x() - low.x()) * wall.right,
                    (high.y() - low.y()) * wall.up, low, surface);
  }

  /// A box on the wall, from `low` to `high` in the wall's coordinates.
  void AddRelief(const WallFrame& wall, const Eigen::Vector3d& low, const Eigen::Vector3d& high,
                 std::uint32_t surface) {
    Eigen::Matrix3d axes;
    axes << wall.right, wall.up, wall.out;
    // The box's own axes are x along the wall, y outwards, z up: ribs of sheet run upwards.
    Eigen::Matrix3d wall_from_box;
    wall_from_box << 1, 0, 0, 0, 0, 1, 0, -1, 0;
    const Eigen::Quaterniond rotation(Eigen::Matrix3d(axes * wall_from_box));
    mesh_->AddBox({rotation, wall.At(low.x(), low.y(), high.z())},
                  {high.x() - low.x(), high.z() - low.z(), high.y() - low.y()}, surface);
  }

 private:
  std::uint32_t object_id_;
  Random random_;
  Mesh* mesh_;
};

constexpr double kPlinthM = 0.9;
constexpr double kGateWidthM = 4.2;
constexpr double kGateHeightM = 4.4;

/// Gates that stand out of the front a little, each with its frame, and the space between them.
void AddGates(const WallFrame& front, double height_m, Painter* painter) {
  Random& random = painter->random();
  const std::uint32_t frame =
      painter->NewSurface(Material::kMetal, Eigen::Vector3f::Constant(0.16F));
  const double gate_high = std::min(kGateHeightM, height_m - 1.5);
  for (double x = random.Uniform(1.5, 5.0); x + kGateWidthM + 1.0 < front.width_m;
       x += kGateWidthM + random.Uniform(2.5, 8.0)) {
    const float bright = static_cast<float>(random.Uniform(0.15, 0.6));
    const std::uint32_t gate =
        painter->NewSurface(Material::kDoor, bright * Eigen::Vector3f(1.0F, 0.95F, 0.9F),
                            {static_cast<float>(kGateWidthM), static_cast<float>(gate_high)});
    painter->AddRelief(front, {x, 0.0, 0.0}, {x + kGateWidthM, gate_high, 0.08}, gate);
    painter->AddRelief(front, {x - 0.25, 0.0, 0.0}, {x, gate_high + 0.25, 0.3}, frame);
    painter->AddRelief(front, {x + kGateWidthM, 0.0, 0.0},
                       {x + kGateWidthM + 0.25, gate_high + 0.25, 0.3}, frame);
    painter->AddRelief(front, {x, gate_high, 0.0}, {x + kGateWidthM, gate_high + 0.25, 0.3}, frame);
    if (random.Uniform() < 0.4) {  // a roof over the ramp
      painter->AddRelief(front, {x - 0.5, gate_high + 0.4, 0.0},
                         {x + kGateWidthM + 0.5, gate_high + 0.55, 2.2}, frame);
    }
  }
}

/// Windows high up, pipes, a sign.
void AddHallTrims(const WallFrame& front, double height_m, Painter* painter) {
  Random& random = painter->random();
  const double w = front.width_m;
  const std::uint32_t metal =
      painter->NewSurface(Material::kMetal, Eigen::Vector3f::Constant(0.22F));
  painter->AddRelief(front, {0.0, height_m - 0.4, 0.0}, {w, height_m + 0.2, 0.2}, metal);
  for (double x = 0.3; x < w; x += random.Uniform(7.0, 11.0)) {
    painter->AddRelief(front, {x, 0.0, 0.02}, {x + 0.16, height_m - 0.4, 0.18}, metal);
  }
  if (random.Uniform() < 0.6 && height_m > 7.0) {
    const double low = height_m - 2.2;
    for (double x = 1.0; x + 2.6 < w; x += 3.4) {
      const std::uint32_t pane =
          painter->NewSurface(Material::kWindow, Eigen::Vector3f::Constant(0.5F), {2.4F, 1.2F});
      painter->AddRelief(front, {x, low, 0.0}, {x + 2.4, low + 1.2, 0.06}, pane);
    }
  } else if (w > 10.0) {
    const double x = random.Uniform(1.0, w - 9.0);
    const float blue = static_cast<float>(random.Uniform(0.05, 0.7));
    const float green = static_cast<float>(random.Uniform(0.05, 0.7));
    const float red = static_cast<float>(random.Uniform(0.05, 0.7));
    const std::uint32_t sign =
        painter->NewSurface(Material::kSign, {blue, green, red}, {7.0F, 1.4F});
    painter->AddRelief(front, {x, height_m - 2.4, 0.0}, {x + 7.0, height_m - 1.0, 0.12}, sign);
  }
}

}  // namespace

void AddHall(const HallSpec& spec, Random random, Mesh* mesh) {
  Painter painter(spec.object_id, random, mesh);
  static const float kPalette[][3] = {
      {0.52F, 0.53F, 0.53F}, {0.34F, 0.32F, 0.3F}, {0.36F, 0.26F, 0.16F}, {0.3F, 0.42F, 0.47F}};
  const float* colour = kPalette[painter.random().Index(4)];
  const std::uint32_t wall =
      painter.NewSurface(Material::kSheet, Eigen::Vector3f(colour[0], colour[1], colour[2]));
  const std::uint32_t plinth =
      painter.NewSurface(Material::kPlaster, Eigen::Vector3f(0.33F, 0.34F, 0.35F));
  const std::uint32_t roof = painter.NewSurface(Material::kMetal, Eigen::Vector3f::Constant(0.3F));
  const WallFrame front = MakeWall(spec.front_left_m, spec.front_right_m);
  const Eigen::Vector3d back = -spec.depth_m * front.out;
  const Eigen::Vector3d corners[4] = {spec.front_left_m, spec.front_right_m,
                                      spec.front_right_m + back, spec.front_left_m + back};
  for (int i = 0; i < 4; ++i) {
    const WallFrame side = MakeWall(corners[i], corners[(i + 1) % 4]);
    painter.AddRectangle(side, {0.0, -1.0}, {side.width_m, kPlinthM}, plinth);
    painter.AddRectangle(side, {0.0, kPlinthM}, {side.width_m, spec.height_m}, wall);
  }
  mesh->AddPatch(front.At(0.0, spec.height_m, 0.0), front.width_m * front.right, back, {0.0, 0.0},
                 roof);
  AddGates(front, spec.height_m, &painter);
  AddHallTrims(front, spec.height_m, &painter);
}

void AddContainers(const Eigen::Vector3d& foot, double heading_rad, std::uint32_t object_id,
                   Random random, Mesh* mesh) {
  constexpr double kWidthM = 2.44;
  constexpr double kHeightM = 2.59;
  static const float kPalette[][3] = {{0.08F, 0.09F, 0.36F}, {0.33F, 0.15F, 0.05F},
                                      {0.1F, 0.27F, 0.1F},   {0.05F, 0.2F, 0.5F},
                                      {0.4F, 0.42F, 0.42F},  {0.1F, 0.12F, 0.22F}};
  Painter painter(object_id, random, mesh);
  const double length_m = painter.random().Uniform() < 0.5 ? 6.06 : 12.19;
  const int count = 1 + static_cast<int>(painter.random().Index(3));
  for (int i = 0; i < count; ++i) {
    const float* colour = kPalette[painter.random().Index(6)];
    const std::uint32_t sheet =
        painter.NewSurface(Material::kSheet, Eigen::Vector3f(colour[0], colour[1], colour[2]));
    const double turned_rad = heading_rad + painter.random().Uniform(-0.02, 0.02);
    const Rigid3 map_from_stack(
        Eigen::Quaterniond(Eigen::AngleAxisd(turned_rad, Eigen::Vector3d::UnitZ())),
        foot + Eigen::Vector3d(0.0, 0.0, i * kHeightM - (i == 0 ? 0.1 : 0.0)));
    const auto at = [&](const Eigen::Vector3d& corner) {
      return map_from_stack * Rigid3(Eigen::Quaterniond::Identity(), corner);
    };
    mesh->AddBox(at({-0.5 * length_m, -0.5 * kWidthM, 0.0}),
                 {length_m, kWidthM, kHeightM + (i == 0 ? 0.1 : 0.0)}, sheet);
    // Lettering on both long sides.
    const float ink = painter.random().Uniform() < 0.5 ? 0.55F : 0.1F;
    const std::uint32_t plate = painter.NewSurface(Material::kSign, Eigen::Vector3f::Constant(ink),
                                                   Eigen::Vector2f(2.0F, 0.5F));
    const double x = painter.random().Uniform(-0.5 * length_m + 0.3, 0.5 * length_m - 2.3);
    mesh->AddBox(at({x, -0.5 * kWidthM - 0.02, 1.6}), {2.0, kWidthM + 0.04, 0.5}, plate);
  }
}

void AddFence(const std::vector<Eigen::Vector3d>& posts_m, std::uint32_t object_id, Random random,
              Mesh* mesh) {
  constexpr double kBarEveryM = 0.13;
  Painter painter(object_id, random, mesh);
  const double height_m = painter.random().Uniform(1.7, 2.2);
  const float shade = static_cast<float>(painter.random().Uniform(0.08, 0.35));
  const std::uint32_t steel =
      painter.NewSurface(Material::kMetal, Eigen::Vector3f::Constant(shade));
  for (std::size_t i = 0; i + 1 < posts_m.size(); ++i) {
    const WallFrame panel = MakeWall(posts_m[i], posts_m[i + 1]);
    painter.AddRelief(panel, {-0.04, -0.3, -0.04}, {0.04, height_m + 0.1, 0.04}, steel);
    for (const double y : {0.15, height_m - 0.2}) {
      painter.AddRelief(panel, {0.0, y, -0.02}, {panel.width_m, y + 0.05, 0.02}, steel);
    }
    for (double x = kBarEveryM; x + 0.05 < panel.width_m; x += kBarEveryM) {
      painter.AddRelief(panel, {x, 0.08, -0.012}, {x + 0.025, height_m, 0.012}, steel);
    }
  }
}

}  // namespace scenecalib
