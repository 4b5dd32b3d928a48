#include <Eigen/Geometry>
#include <array>
#include <cmath>

#include "scenecalib/simulation/props.h"

namespace scenecalib {

namespace {

/// Writes one car; the silhouette seen from the left is extruded across.
class CarBuilder {
 public:
  CarBuilder(const Rigid3& map_from_car, std::uint32_t object_id, Random random, Mesh* mesh)
      : map_from_car_(map_from_car), object_id_(object_id), random_(random), mesh_(mesh) {
    // Most cars are grey, from black to white; a few have a colour.
    const auto grey = static_cast<float>(random_.Uniform(0.04, 0.6));
    const float colour = random_.Uniform() < 0.6 ? 0.05F : 0.45F;
    const auto shade = [&] {
      return grey * (1.0F + colour * static_cast<float>(random_.Uniform(-1.6, 1.6)));
    };
    const float blue = shade(), green = shade(), red = shade();
    paint_ = NewSurface(Material::kCarPaint, {blue, green, red});
    glass_ = NewSurface(Material::kDarkGlass, {0.07F, 0.065F, 0.06F});
    rubber_ = NewSurface(Material::kMetal, Eigen::Vector3f::Constant(0.05F));
    rim_ = NewSurface(Material::kMetal, Eigen::Vector3f::Constant(0.45F));
    length_m_ = random_.Uniform(3.9, 4.6);
    width_m_ = random_.Uniform(1.7, 1.85);
    roof_m_ = random_.Uniform(1.42, 1.65);
  }

  void Build() {
    const double f = 0.5 * length_m_;  // front
    const double w = 0.5 * width_m_;
    // The body below the windows: underside, front, bonnet, beltline, tail.
    const std::array<Eigen::Vector2d, 8> body = {
        Eigen::Vector2d(-f, 0.32), {f - 0.05, 0.28}, {f, 0.5},         {f - 0.1, 0.72},
        {0.42 * f, 0.95},          {-0.85 * f, 1.0}, {-f + 0.02, 0.9}, {-f - 0.03, 0.6}};
    Extrude(body.data(), 8, w, w, paint_, paint_);
    // The cabin, narrower at the roof: windscreen, roof, rear window.
    const double windscreen = 0.05 * f;
    const double rear = -0.6 * f;
    AddCabin({0.44 * f, 0.93}, {windscreen, roof_m_}, {rear, roof_m_ - 0.03}, {-0.9 * f, 0.98},
             w - 0.03, w - 0.18);
    for (const double x : {-0.62 * f, 0.62 * f}) {
      for (const double side : {-1.0, 1.0}) AddWheel(x, side * (w - 0.02), side);
    }
    AddDetails(f, w);
  }

 private:
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

  Eigen::Vector3d At(double x, double y, double z) const {
    return map_from_car_ * Eigen::Vector3d(x, y, z);
  }

  void Extrude(const Eigen::Vector2d* profile, int n, double half_width, double top_half_width,
               std::uint32_t skin, std::uint32_t sides) {
    double along = 0.0;
    for (int i = 0; i < n; ++i) {
      const Eigen::Vector2d& a = profile[i];
      const Eigen::Vector2d& b = profile[(i + 1) % n];
      const double next = along + (b - a).norm();
      mesh_->AddQuad(At(a.x(), -half_width, a.y()), At(b.x(), -top_half_width, b.y()),
                     At(b.x(), top_half_width, b.y()), At(a.x(), half_width, a.y()), {along, 0.0},
                     {next, 0.0}, {next, 2.0 * half_width}, {along, 2.0 * half_width}, skin);
      along = next;
    }
    for (const double side : {-1.0, 1.0}) {  // fans
      for (int i = 1; i + 1 < n; ++i) {
        const Eigen::Vector2d triangle[3] = {profile[0], profile[i], profile[i + 1]};
        Eigen::Vector3d points[3];
        Eigen::Vector2d uv[3];
        for (int k = 0; k < 3; ++k) {
          points[k] = At(triangle[k].x(), side * half_width, triangle[k].y());
          uv[k] = triangle[k] + Eigen::Vector2d(20.0 + 10.0 * side, 5.0);
        }
        mesh_->AddTriangle(points, uv, sides);
      }
    }
  }

  void AddCabin(const Eigen::Vector2d& front, const Eigen::Vector2d& front_top,
                const Eigen::Vector2d& rear_top, const Eigen::Vector2d& rear, double w,
                double top_w) {
    const auto quad = [this](const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                             const Eigen::Vector3d& c, const Eigen::Vector3d& d, double offset,
                             std::uint32_t surface) {
      const double width = (b - a).norm();
      const double height = (d - a).norm();
      mesh_->AddQuad(a, b, c, d, {offset, 0.0}, {offset + width, 0.0}, {offset + width, height},
                     {offset, height}, surface);
    };
    const auto p = [this](const Eigen::Vector2d& xz, double y) { return At(xz.x(), y, xz.y()); };
    quad(p(front, -w), p(front, w), p(front_top, top_w), p(front_top, -top_w), 40.0, glass_);
    quad(p(front_top, -top_w), p(front_top, top_w), p(rear_top, top_w), p(rear_top, -top_w), 50.0,
         paint_);
    quad(p(rear, -w), p(rear, w), p(rear_top, top_w), p(rear_top, -top_w), 60.0, glass_);
    const double pillar_x = 0.35 * (front_top.x() + 2.0 * rear_top.x()) / 1.05;
    for (const double side : {-1.0, 1.0}) {
      quad(p(rear, side * w), p(front, side * w), p(front_top, side * top_w),
           p(rear_top, side * top_w), 70.0 + 10.0 * side, glass_);
      // The pillar between the doors stands a little proud.
      const double low_y = side * (w + 0.01);
      const double top_y = side * (top_w + 0.01);
      quad(At(pillar_x, low_y, front.y()), At(pillar_x + 0.12, low_y, front.y()),
           At(pillar_x + 0.12, top_y, front_top.y() - 0.03),
           At(pillar_x, top_y, front_top.y() - 0.03), 90.0, paint_);
    }
  }

  void AddWheel(double x, double y, double side) {
    constexpr int kSides = 14;
    constexpr double kRadius = 0.32;
    const double outer = y + 0.04 * side;
    mesh_->AddTube(At(x, y - 0.2 * side, kRadius), At(x, outer, kRadius), kRadius, kRadius, kSides,
                   rubber_);
    const auto disc = [&](double radius, double at_y, std::uint32_t surface) {
      for (int i = 0; i < kSides; ++i) {
        const double a = 2.0 * M_PI * i / kSides;
        const double b = 2.0 * M_PI * (i + 1) / kSides;
        const Eigen::Vector2d rim_a(radius * std::cos(a), radius * std::sin(a));
        const Eigen::Vector2d rim_b(radius * std::cos(b), radius * std::sin(b));
        const Eigen::Vector3d points[3] = {At(x, at_y, kRadius),
                                           At(x + rim_a.x(), at_y, kRadius + rim_a.y()),
                                           At(x + rim_b.x(), at_y, kRadius + rim_b.y())};
        const Eigen::Vector2d uv[3] = {Eigen::Vector2d::Zero(), rim_a, rim_b};
        mesh_->AddTriangle(points, uv, surface);
      }
    };
    disc(kRadius, outer, rubber_);
    disc(0.6 * kRadius, outer + 0.01 * side, rim_);
  }

  void AddBlock(double x0, double x1, double y0, double y1, double z0, double z1,
                std::uint32_t surface) {
    const Rigid3 car_from_box(Eigen::Quaterniond::Identity(), {x0, y0, z0});
    mesh_->AddBox(map_from_car_ * car_from_box, {x1 - x0, y1 - y0, z1 - z0}, surface);
  }

  void AddDetails(double f, double w) {
    const std::uint32_t lamp = NewSurface(Material::kStone, Eigen::Vector3f::Constant(0.75F));
    const std::uint32_t tail = NewSurface(Material::kStone, {0.05F, 0.05F, 0.5F});
    const std::uint32_t plate =
        NewSurface(Material::kSign, Eigen::Vector3f::Constant(0.8F), Eigen::Vector2f(0.52F, 0.22F));
    for (const double side : {-1.0, 1.0}) {
      const double y = side * (w - 0.3);
      AddBlock(f - 0.12, f - 0.01, y - 0.2, y + 0.2, 0.55, 0.7, lamp);
      AddBlock(-f - 0.05, -f + 0.05, y - 0.15, y + 0.15, 0.68, 0.9, tail);
      const double mirror = side * (w + 0.1);
      AddBlock(0.36 * f, 0.36 * f + 0.08, mirror - 0.1, mirror + 0.1, 0.95, 1.1, paint_);
    }
    AddBlock(f - 0.02, f + 0.02, -0.26, 0.26, 0.36, 0.48, plate);
    AddBlock(-f - 0.06, -f - 0.02, -0.26, 0.26, 0.5, 0.62, plate);
  }

  const Rigid3 map_from_car_;
  const std::uint32_t object_id_;
  Random random_;
  Mesh* mesh_;
  std::uint32_t paint_, glass_, rubber_, rim_;
  double length_m_, width_m_, roof_m_;
};

}  // namespace

void AddCar(const Rigid3& map_from_car, std::uint32_t object_id, Random random, Mesh* mesh) {
  CarBuilder(map_from_car, object_id, random, mesh).Build();
}

}  // namespace scenecalib
