// The ground's mesh of 100 m of street: time, memory, and height errors against an exact ground
// (bumps of 1 cm, kerbs of 12 cm), seen by a lidar of 64 x 1024 with 2 cm of range noise that
// drives along it at 8 m/s.

#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "../src/mapping/ground_mesh.h"
#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr double kLength_m = 100.0;
constexpr double kHalfRoad_m = 3.5;
constexpr double kHalfStreet_m = 10.0;
constexpr double kKerb_m = 0.12;
constexpr double kSensorHeight_m = 1.9;
constexpr double kNoise_m = 0.02;
constexpr double kMaxRange_m = 50.0;
/// The street is not in line with the map's axes, so that its kerbs cross the mesh's lattice.
const Eigen::AngleAxisd kMapFromStreet(0.35, Eigen::Vector3d::UnitZ());

double Bumps(const Eigen::Vector3d& p) {
  return 0.01 * std::sin(2.0 * M_PI * p.x() / 4.1) * std::sin(2.0 * M_PI * p.y() / 3.1);
}

double HeightAt(const Eigen::Vector3d& p) {
  return Bumps(p) + (std::abs(p.y()) > kHalfRoad_m ? kKerb_m : 0.0);
}

/// Range at which a ray from above the road meets the ground; none beyond kMaxRange_m.
std::optional<double> CastRay(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
  for (const double step_m : {0.0, kKerb_m}) {
    double range_m = (step_m - origin.z()) / direction.z();
    for (int i = 0; i < 4; ++i) {  // bumps are gentle: a few steps meet them to micrometres
      range_m = (step_m + Bumps(origin + range_m * direction) - origin.z()) / direction.z();
    }
    const double y = (origin + range_m * direction).y();
    if ((std::abs(y) > kHalfRoad_m) != (step_m > 0.0)) continue;
    if (range_m > kMaxRange_m || std::abs(y) > kHalfStreet_m) return std::nullopt;
    return range_m;
  }
  // Neither on the road nor on the pavement: the kerb's face.
  const double range_m = (std::copysign(kHalfRoad_m, direction.y()) - origin.y()) / direction.y();
  if (range_m > kMaxRange_m) return std::nullopt;
  return range_m;
}

std::vector<LidarReturn> DriveAlong() {
  Random random(1);
  std::vector<LidarReturn> points;
  const int num_scans = static_cast<int>(kLength_m / 0.8);
  for (int scan = 0; scan < num_scans; ++scan) {
    for (int column = 0; column < 1024; ++column) {
      const Eigen::Vector3d origin(0.8 * (scan + column / 1024.0), 0.0, kSensorHeight_m);
      const double azimuth = 2.0 * M_PI * column / 1024.0;
      for (int ring = 0; ring < 64; ++ring) {
        const double elevation = (-25.0 + 40.0 * ring / 63.0) * M_PI / 180.0;
        if (elevation > -0.02) break;
        const Eigen::Vector3d direction(std::cos(azimuth) * std::cos(elevation),
                                        std::sin(azimuth) * std::cos(elevation),
                                        std::sin(elevation));
        const auto range_m = CastRay(origin, direction);
        if (!range_m || *range_m < 3.0) continue;
        LidarReturn point;
        const double measured_m = *range_m + kNoise_m * random.Gaussian();
        point.position_m = (kMapFromStreet * (origin + measured_m * direction)).cast<float>();
        point.origin_m = (kMapFromStreet * origin).cast<float>();
        point.scan = scan;
        points.push_back(point);
      }
    }
  }
  return points;
}

/// RMS height errors of the mesh, by area, within 100 m of road: apart from the kerbs and within
/// 15 cm of them.
struct HeightErrors {
  double flat_m = 0.0;
  double kerb_m = 0.0;
};

HeightErrors Compare(const TriangleMesh& mesh) {
  Random random(2);
  std::array<double, 2> squares = {0.0, 0.0};
  std::array<int, 2> counts = {0, 0};
  double owed = 0.0;
  for (const std::array<int, 3>& t : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices_m[t[0]].cast<double>();
    const Eigen::Vector3d u = mesh.vertices_m[t[1]].cast<double>() - a;
    const Eigen::Vector3d v = mesh.vertices_m[t[2]].cast<double>() - a;
    for (owed += 50.0 * std::abs(u.x() * v.y() - u.y() * v.x()); owed >= 1.0; owed -= 1.0) {
      double s = random.Uniform();
      double r = random.Uniform();
      if (s + r > 1.0) {
        s = 1.0 - s;
        r = 1.0 - r;
      }
      const Eigen::Vector3d p = kMapFromStreet.inverse() * (a + s * u + r * v);
      if (p.x() < 0.0 || p.x() > kLength_m) continue;
      const double error_m = p.z() - HeightAt(p);
      const int at_kerb = std::abs(std::abs(p.y()) - kHalfRoad_m) < 0.15 ? 1 : 0;
      squares[at_kerb] += error_m * error_m;
      ++counts[at_kerb];
    }
  }
  return {std::sqrt(squares[0] / counts[0]), std::sqrt(squares[1] / counts[1])};
}

double PeakMemoryMiB() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;
}

void MeshAStreet(benchmark::State& state) {
  const std::vector<LidarReturn> points = DriveAlong();
  const std::vector<PointLabel> labels(points.size(), PointLabel::kGround);
  const double before_mib = PeakMemoryMiB();
  TriangleMesh mesh;
  for (auto _ : state) mesh = BuildGroundMesh(points, labels, GroundOptions());
  const HeightErrors errors = Compare(mesh);
  state.counters["returns"] = static_cast<double>(points.size());
  state.counters["triangles"] = static_cast<double>(mesh.triangles.size());
  state.counters["peak_MiB"] = PeakMemoryMiB() - before_mib;
  state.counters["rms_mm"] = 1e3 * errors.flat_m;
  state.counters["kerb_rms_mm"] = 1e3 * errors.kerb_m;
}
BENCHMARK(MeshAStreet)->Unit(benchmark::kSecond)->UseRealTime()->MeasureProcessCPUTime();

}  // namespace
}  // namespace scenecalib
