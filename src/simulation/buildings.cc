#include "scenecalib/simulation/buildings.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "wall_frame.h"

namespace scenecalib {

namespace {

enum class Opening { kNone, kWindow, kDoor, kShop };

/// The look of one house, drawn once.
struct Style {
  Eigen::Vector3f wall_albedo, frame_albedo, trim_albedo;
  Material wall_material;
  double ground_floor_m, floor_m, bay_m, window_width_m, window_height_m, sill_m, recess_m;
  bool balconies, trims;
};

Style DrawStyle(const HouseSpec& spec, Random* random) {
  static const float kPalette[][3] = {{0.42F, 0.55F, 0.62F}, {0.30F, 0.42F, 0.55F},
                                      {0.50F, 0.52F, 0.52F}, {0.35F, 0.48F, 0.60F},
                                      {0.55F, 0.50F, 0.42F}, {0.38F, 0.45F, 0.40F}};
  Style style;
  style.wall_material = random->Uniform() < 0.4 ? Material::kBrick : Material::kPlaster;
  const float* colour = kPalette[random->Index(6)];
  style.wall_albedo = Eigen::Vector3f(colour[0], colour[1], colour[2]);
  if (style.wall_material == Material::kBrick) style.wall_albedo = {0.14F, 0.18F, 0.34F};
  style.wall_albedo *= static_cast<float>(random->Uniform(0.75, 1.1));
  style.frame_albedo = Eigen::Vector3f::Constant(random->Uniform() < 0.7 ? 0.65F : 0.12F);
  style.trim_albedo =
      Eigen::Vector3f(0.45F, 0.48F, 0.5F) * static_cast<float>(random->Uniform(0.8, 1.3));
  style.ground_floor_m = spec.shop ? random->Uniform(3.6, 4.2) : random->Uniform(2.9, 3.3);
  style.floor_m = random->Uniform(2.8, 3.3);
  style.bay_m = random->Uniform(2.1, 3.2);
  style.window_width_m = random->Uniform(0.95, 1.35);
  style.window_height_m = random->Uniform(1.3, 1.75);
  style.sill_m = random->Uniform(0.75, 1.0);
  style.recess_m = random->Uniform(0.12, 0.28);
  style.balconies = random->Uniform() < 0.4;
  style.trims = random->Uniform() < 0.7;
  return style;
}

/// Writes one house; holds what its parts share.
class HouseBuilder {
 public:
  HouseBuilder(const HouseSpec& spec, Random random, Mesh* mesh)
      : spec_(spec), random_(random), mesh_(mesh), style_(DrawStyle(spec, &random_)) {
    wall_ = NewSurface(style_.wall_material, style_.wall_albedo);
    trim_ = NewSurface(Material::kStone, style_.trim_albedo);
  }

  void Build() {
    const WallFrame front = MakeWall(spec_.front_left_m, spec_.front_right_m);
    const Eigen::Vector3d back = -spec_.depth_m * front.out;
    const Eigen::Vector3d left_back = spec_.front_left_m + back;
    const Eigen::Vector3d right_back = spec_.front_right_m + back;
    AddWall(front, spec_.shop, true);
    AddTrims(front);
    if (spec_.windows_on_all_sides) {
      AddWall(MakeWall(left_back, spec_.front_left_m), false, false);
      AddWall(MakeWall(spec_.front_right_m, right_back), false, false);
      AddWall(MakeWall(right_back, left_back), false, false);
    } else {
      AddBlankWall(MakeWall(left_back, spec_.front_left_m));
      AddBlankWall(MakeWall(spec_.front_right_m, right_back));
      AddBlankWall(MakeWall(right_back, left_back));
    }
    AddRoof(front);
  }

 private:
  std::uint32_t NewSurface(Material material, const Eigen::Vector3f& albedo,
                           const Eigen::Vector2f& extent_m = Eigen::Vector2f::Ones()) {
    Surface surface;
    surface.material = material;
    surface.albedo = albedo;
    surface.seed = static_cast<std::uint32_t>(random_.NextBits());
    surface.extent_m = extent_m;
    surface.object_id = spec_.object_id;
    return mesh_->AddSurface(surface);
  }

  void AddRectangle(const WallFrame& wall, double x0, double x1, double y0, double y1) {
    if (x1 - x0 < 1e-3 || y1 - y0 < 1e-3) return;
    mesh_->AddPatch(wall.At(x0, y0, 0.0), (x1 - x0) * wall.right, (y1 - y0) * wall.up, {x0, y0},
                    wall_);
  }

  /// A box on the wall's outside.
  void AddRelief(const WallFrame& wall, double x0, double x1, double y0, double y1, double z0,
                 double z1, std::uint32_t surface) {
    Eigen::Matrix3d axes;
    axes << wall.right, wall.up, wall.out;
    const Rigid3 map_from_box(Eigen::Quaterniond(axes), wall.At(x0, y0, z0));
    mesh_->AddBox(map_from_box, {x1 - x0, y1 - y0, z1 - z0}, surface);
  }

  void AddBlankWall(const WallFrame& wall) {
    AddRectangle(wall, 0.0, wall.width_m, -0.5, spec_.height_m);
  }

  /// Panel and reveals of one opening.
  void AddOpening(const WallFrame& wall, double x0, double x1, double y0, double y1,
                  Opening opening) {
    const Eigen::Vector2f size(static_cast<float>(x1 - x0), static_cast<float>(y1 - y0));
    std::uint32_t panel = 0;
    if (opening == Opening::kDoor) {
      const auto hue = [this] { return static_cast<float>(random_.Uniform(0.06, 0.35)); };
      const float blue = hue(), green = hue(), red = hue();
      panel = NewSurface(Material::kDoor, {blue, green, red}, size);
    } else {
      panel = NewSurface(Material::kWindow, style_.frame_albedo, size);
    }
    const double r = -style_.recess_m;
    mesh_->AddPatch(wall.At(x0, y0, r), (x1 - x0) * wall.right, (y1 - y0) * wall.up, {0.0, 0.0},
                    panel);
    mesh_->AddPatch(wall.At(x0, y0, r), -r * wall.out, (y1 - y0) * wall.up, {11.0, y0}, trim_);
    mesh_->AddPatch(wall.At(x1, y0, r), -r * wall.out, (y1 - y0) * wall.up, {13.0, y0}, trim_);
    mesh_->AddPatch(wall.At(x0, y0, r), -r * wall.out, (x1 - x0) * wall.right, {17.0, x0}, trim_);
    mesh_->AddPatch(wall.At(x0, y1, r), -r * wall.out, (x1 - x0) * wall.right, {19.0, x0}, trim_);
    if (opening == Opening::kWindow) {
      AddRelief(wall, x0 - 0.08, x1 + 0.08, y0 - 0.08, y0, 0.0, 0.1, trim_);  // sill
      if (style_.trims) {
        AddRelief(wall, x0 - 0.1, x1 + 0.1, y1, y1 + 0.15, 0.0, 0.06, trim_);  // lintel
      }
    }
  }

  /// One storey: bays with an opening each.
  void AddStorey(const WallFrame& wall, double y0, double y1, bool shop, int door_bay) {
    const int bays = std::max(1, static_cast<int>(std::lround(wall.width_m / style_.bay_m)));
    const double bay_m = wall.width_m / bays;
    for (int bay = 0; bay < bays; ++bay) {
      const double left = bay * bay_m;
      const double right = left + bay_m;
      const Opening opening = bay == door_bay ? Opening::kDoor
                              : shop          ? Opening::kShop
                                              : Opening::kWindow;
      double width = std::min(style_.window_width_m, bay_m - 0.4);
      double low = y0 + style_.sill_m;
      double high = std::min(low + style_.window_height_m, y1 - 0.3);
      if (opening == Opening::kDoor) {
        width = std::min(1.1, bay_m - 0.4);
        low = std::max(y0, 0.02);
        high = low + 2.2;
      } else if (opening == Opening::kShop) {
        width = bay_m - 0.4;
        low = y0 + 0.5;
        high = y1 - 0.9;
      }
      const double x0 = 0.5 * (left + right - width);
      const double x1 = x0 + width;
      AddRectangle(wall, left, x0, y0, y1);
      AddRectangle(wall, x1, right, y0, y1);
      AddRectangle(wall, x0, x1, y0, low);
      AddRectangle(wall, x0, x1, high, y1);
      AddOpening(wall, x0, x1, low, high, opening);
    }
  }

  void AddWall(const WallFrame& wall, bool shop, bool with_door) {
    AddRectangle(wall, 0.0, wall.width_m, -0.5, 0.0);
    const int bays = std::max(1, static_cast<int>(std::lround(wall.width_m / style_.bay_m)));
    const int door_bay =
        with_door ? static_cast<int>(random_.Index(static_cast<std::uint64_t>(bays))) : -1;
    const double first_top = std::min(style_.ground_floor_m, spec_.height_m);
    AddStorey(wall, 0.0, first_top, shop, door_bay);
    double y = first_top;
    while (y + 2.4 < spec_.height_m) {
      const double top = y + std::min(style_.floor_m, spec_.height_m - y);
      AddStorey(wall, y, top, false, -1);
      if (with_door && style_.balconies && random_.Uniform() < 0.6) AddBalcony(wall, y + 0.1);
      y = top;
    }
    AddRectangle(wall, 0.0, wall.width_m, y, spec_.height_m);
  }

  void AddBalcony(const WallFrame& wall, double y) {
    const double x0 = random_.Uniform(0.1, 0.4) * wall.width_m;
    const double x1 = std::min(x0 + random_.Uniform(2.0, 4.0), wall.width_m - 0.2);
    AddRelief(wall, x0, x1, y - 0.15, y, 0.0, 0.9, trim_);
    const std::uint32_t rail = NewSurface(Material::kMetal, Eigen::Vector3f::Constant(0.12F));
    AddRelief(wall, x0, x1, y + 0.95, y + 1.0, 0.85, 0.9, rail);
    for (double x = x0; x < x1; x += 0.35)
      AddRelief(wall, x, x + 0.04, y, y + 0.95, 0.86, 0.9, rail);
  }

  /// Plinth, cornices, sign and rain pipe of the front.
  void AddTrims(const WallFrame& wall) {
    const double w = wall.width_m;
    AddRelief(wall, 0.0, w, style_.ground_floor_m - 0.15, style_.ground_floor_m + 0.1, 0.0, 0.12,
              trim_);
    AddRelief(wall, 0.0, w, spec_.height_m - 0.3, spec_.height_m, 0.0, 0.35, trim_);
    const std::uint32_t pipe = NewSurface(Material::kMetal, Eigen::Vector3f::Constant(0.25F));
    AddRelief(wall, 0.1, 0.2, 0.0, spec_.height_m - 0.3, 0.03, 0.13, pipe);
    if (spec_.shop) {
      const double x0 = random_.Uniform(0.3, 1.0);
      const double x1 = w - random_.Uniform(0.3, 1.0);
      const Eigen::Vector2f size(static_cast<float>(x1 - x0), 0.6F);
      const auto hue = [this] { return static_cast<float>(random_.Uniform(0.05, 0.7)); };
      const float blue = hue(), green = hue(), red = hue();
      const std::uint32_t sign = NewSurface(Material::kSign, {blue, green, red}, size);
      const double y0 = style_.ground_floor_m - 0.8;
      AddRelief(wall, x0, x1, y0, y0 + 0.6, 0.0, 0.15, sign);
    }
  }

  void AddRoof(const WallFrame& front) {
    const std::uint32_t roof =
        NewSurface(Material::kRoof, Eigen::Vector3f(0.13F, 0.17F, 0.3F) *
                                        static_cast<float>(random_.Uniform(0.7, 1.2)));
    const double h = spec_.height_m;
    const double w = front.width_m;
    const double middle = 0.5 * spec_.depth_m;
    const double rise = (spec_.gabled ? 0.7 : 0.5) * middle;
    const Eigen::Vector3d eave_rise = rise * front.up;
    mesh_->AddPatch(front.At(0.0, h, 0.35), w * front.right,
                    -(middle + 0.35) * front.out + eave_rise, {0.0, 0.0}, roof);
    mesh_->AddPatch(front.At(0.0, h, -spec_.depth_m), w * front.right,
                    middle * front.out + eave_rise, {0.0, 40.0}, roof);
    for (const double x : {0.0, w}) {  // the gables
      const Eigen::Vector3d points[3] = {front.At(x, h, 0.0), front.At(x, h, -spec_.depth_m),
                                         front.At(x, h + rise, -middle)};
      const Eigen::Vector2d uv[3] = {{x, h}, {x + spec_.depth_m, h}, {x + middle, h + rise}};
      mesh_->AddTriangle(points, uv, wall_);
    }
    if (random_.Uniform() < 0.6) {  // chimney
      const double x = random_.Uniform(0.2, 0.8) * w;
      AddRelief(front, x, x + 0.7, h, h + rise + 0.8, -middle - 0.4, -middle + 0.4, wall_);
    }
  }

  const HouseSpec spec_;
  Random random_;
  Mesh* mesh_;
  const Style style_;
  std::uint32_t wall_ = 0;
  std::uint32_t trim_ = 0;
};

}  // namespace

void AddHouse(const HouseSpec& spec, Random random, Mesh* mesh) {
  HouseBuilder(spec, random, mesh).Build();
}

}  // namespace scenecalib
