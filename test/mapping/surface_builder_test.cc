#include "scenecalib/mapping/surface_builder.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <sstream>
#include <string>

#include "mapping/analytic_street.h"
#include "scenecalib/mapping/ray_caster.h"

namespace scenecalib {
namespace {

using testing::AnalyticStreet;
using testing::RecordStreet;
using testing::StreetHit;
using testing::StreetLidar;
using testing::StreetRecording;

double Quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values.at(static_cast<std::size_t>(q * static_cast<double>(values.size() - 1)));
}

/// One street with a moving car, recorded and built once for all tests.
class SurfacesOfAStreet : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    recording_ = new StreetRecording(RecordStreet(AnalyticStreet(), StreetLidar()));
    surfaces_ = new Result<Surfaces>(BuildSurfaces(recording_->scans, SurfaceOptions(), {}));
    ASSERT_TRUE(surfaces_->ok()) << surfaces_->status().message();
    SceneMap map;
    map.ground = (*surfaces_)->ground;
    map.surfels = (*surfaces_)->surfels;
    caster_ = new Result<RayCaster>(RayCaster::Create(map));
    ASSERT_TRUE(caster_->ok());
  }
  static void TearDownTestSuite() {
    delete caster_;
    delete surfaces_;
    delete recording_;
  }

  struct Comparison {
    std::vector<double> distances_m;  ///< along the true normal
    std::vector<double> angles_rad;   ///< between the normals
    int num_rays = 0;
    int num_missed = 0;
    int num_gross = 0;  ///< farther off than 10 cm

    /// For the protocol: the table in docs/accuracy.md is made of such lines.
    std::string Describe() const {
      std::ostringstream text;
      text << num_rays << " rays, missed " << MissedShare() << ", gross " << GrossShare()
           << ", distance p50 " << Quantile(distances_m, 0.5) << " p95 "
           << Quantile(distances_m, 0.95) << " m, angle p50 " << Quantile(angles_rad, 0.5)
           << " p90 " << Quantile(angles_rad, 0.9) << " rad";
      return text.str();
    }
    double GrossShare() const { return static_cast<double>(num_gross) / num_rays; }
    double MissedShare() const { return static_cast<double>(num_missed) / num_rays; }
  };

  /// Rays from where a camera could be, against the street without the moving car. Only planar hits
  /// are compared: the others tie no track to a plane.
  static Comparison Compare(const std::vector<StreetHit::Thing>& things) {
    AnalyticStreet street;
    street.has_moving_car = false;
    Random random(11);
    Comparison comparison;
    for (int i = 0; i < 60000; ++i) {
      const Eigen::Vector3d origin(random.Uniform(-2.0, 8.0), random.Uniform(-1.5, 0.5), 1.5);
      const double azimuth = random.Uniform(-M_PI, M_PI);
      const double elevation = random.Uniform(-0.35, 0.25);
      const Eigen::Vector3d direction(std::cos(azimuth) * std::cos(elevation),
                                      std::sin(azimuth) * std::cos(elevation), std::sin(elevation));
      const auto truth = street.Cast(origin, direction, 0.0);
      if (!truth || truth->range_m > 15.0) continue;
      if (std::find(things.begin(), things.end(), truth->thing) == things.end()) continue;
      ++comparison.num_rays;
      const auto hit = (*caster_)->Cast({origin, direction}, 60.0);
      if (!hit) {
        ++comparison.num_missed;
        continue;
      }
      if (!hit->planar) continue;
      const Eigen::Vector3d true_point = origin + truth->range_m * direction;
      comparison.distances_m.push_back(
          std::abs(truth->normal.dot(hit->point_in_map_m - true_point)));
      comparison.angles_rad.push_back(
          std::acos(std::min(1.0, std::abs(truth->normal.dot(hit->normal_in_map)))));
      if (comparison.distances_m.back() > 0.1) ++comparison.num_gross;
    }
    return comparison;
  }

  static StreetRecording* recording_;
  static Result<Surfaces>* surfaces_;
  static Result<RayCaster>* caster_;
};

StreetRecording* SurfacesOfAStreet::recording_ = nullptr;
Result<Surfaces>* SurfacesOfAStreet::surfaces_ = nullptr;
Result<RayCaster>* SurfacesOfAStreet::caster_ = nullptr;

TEST_F(SurfacesOfAStreet, GroundIsGoodToMillimetres) {
  const Comparison c = Compare({StreetHit::Thing::kRoad, StreetHit::Thing::kPavement});
  ASSERT_GT(c.distances_m.size(), 10000u);
  RecordProperty("errors", c.Describe());
  EXPECT_LT(Quantile(c.distances_m, 0.5), 0.0015);
  EXPECT_LT(Quantile(c.distances_m, 0.95), 0.006);
  EXPECT_LT(c.GrossShare(), 0.01);
  EXPECT_LT(c.MissedShare(), 0.03) << "below the vehicle and around its start nothing was seen";
}

TEST_F(SurfacesOfAStreet, SurfelsLieOnTheWalls) {
  const Comparison c = Compare({StreetHit::Thing::kFacade, StreetHit::Thing::kParkedCar});
  ASSERT_GT(c.distances_m.size(), 10000u);
  RecordProperty("errors", c.Describe());
  EXPECT_LT(Quantile(c.distances_m, 0.5), 0.004);
  EXPECT_LT(Quantile(c.angles_rad, 0.9), 0.03);
  EXPECT_LT(c.GrossShare(), 0.03);
  EXPECT_LT(c.MissedShare(), 0.04);
}

TEST_F(SurfacesOfAStreet, APoleStaysAndHidesWhatIsBehind) {
  const Comparison c = Compare({StreetHit::Thing::kPole});
  ASSERT_GT(c.num_rays, 50);
  EXPECT_LT(c.GrossShare(), 0.25) << "its silhouette is centimetres wide";
}

TEST_F(SurfacesOfAStreet, AMovingCarIsRemovedAndAParkedOneStays) {
  ASSERT_GT(recording_->num_moving_returns, 5000);
  const int num_removed = (*surfaces_)->num_points_moving;
  const int num_static = recording_->num_returns - recording_->num_moving_returns;
  // Removed returns are moving ones, but for a static loss of at most 2 %.
  EXPECT_GT(num_removed, 0.90 * recording_->num_moving_returns);
  EXPECT_LT(num_removed, recording_->num_moving_returns + 0.02 * num_static);
  // Nothing is left standing on the lane that it drove along.
  Random random(5);
  int num_on_lane = 0;
  int num_in_the_way = 0;
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d origin(random.Uniform(-2.0, 6.0), -1.0, 1.5);
    const double x = random.Uniform(-4.0, 10.0);
    const Eigen::Vector3d target(x, random.Uniform(1.5, 2.8), AnalyticStreet::kSlope * x);
    const auto hit = (*caster_)->Cast({origin, (target - origin).normalized()}, 60.0);
    ++num_on_lane;
    if (hit && hit->range_m < (target - origin).norm() - 0.3) ++num_in_the_way;
  }
  EXPECT_LT(num_in_the_way, 0.01 * num_on_lane);
  const Comparison parked = Compare({StreetHit::Thing::kParkedCar});
  ASSERT_GT(parked.num_rays, 500);
  EXPECT_LT(parked.MissedShare() + parked.GrossShare(), 0.08);
}

TEST_F(SurfacesOfAStreet, EverySurfelIsWellFormedAndLooksAtTheSensor) {
  const StreetLidar lidar;
  int num_planar = 0;
  for (const Surfel& surfel : (*surfaces_)->surfels) {
    ASSERT_NEAR(surfel.normal.norm(), 1.0F, 1e-4F);
    ASSERT_GT(surfel.radius_m, 0.0F);
    ASSERT_GT(surfel.num_points, 0);
    ASSERT_LE(surfel.first_seen_ns, surfel.last_seen_ns);
    if (!surfel.planar) continue;
    ++num_planar;
    // From somewhere along the path the disc is seen from its front.
    bool seen = false;
    for (double t = 0.0; t <= 3.0; t += 0.25) {
      seen |= surfel.normal.dot(lidar.PositionAt(t).cast<float>() - surfel.center_m) > 0.0F;
    }
    EXPECT_TRUE(seen);
  }
  EXPECT_GT(num_planar, 100);
  EXPECT_NEAR((*surfaces_)->median_surfel_thickness_m, lidar.noise_m, 0.012);
}

TEST_F(SurfacesOfAStreet, TheGroundMeshIsSeenCounterClockwiseFromAbove) {
  const TriangleMesh& mesh = (*surfaces_)->ground;
  ASSERT_GT(mesh.triangles.size(), 1000u);
  for (const auto& triangle : mesh.triangles) {
    const Eigen::Vector3f& a = mesh.vertices_m.at(triangle[0]);
    const Eigen::Vector3f& b = mesh.vertices_m.at(triangle[1]);
    const Eigen::Vector3f& c = mesh.vertices_m.at(triangle[2]);
    ASSERT_GE((b - a).cross(c - a).z(), 0.0F);
  }
}

TEST_F(SurfacesOfAStreet, AreTheSameWithOneThread) {
  tbb::global_control one_thread(tbb::global_control::max_allowed_parallelism, 1);
  const auto again = BuildSurfaces(recording_->scans, SurfaceOptions(), {});
  ASSERT_TRUE(again.ok());
  const Surfaces& first = **surfaces_;
  EXPECT_EQ(again->num_points_moving, first.num_points_moving);
  ASSERT_EQ(again->ground.vertices_m.size(), first.ground.vertices_m.size());
  for (std::size_t i = 0; i < first.ground.vertices_m.size(); ++i) {
    ASSERT_EQ(again->ground.vertices_m[i], first.ground.vertices_m[i]);
  }
  ASSERT_EQ(again->surfels.size(), first.surfels.size());
  for (std::size_t i = 0; i < first.surfels.size(); ++i) {
    ASSERT_EQ(again->surfels[i].center_m, first.surfels[i].center_m);
    ASSERT_EQ(again->surfels[i].normal, first.surfels[i].normal);
    ASSERT_EQ(again->surfels[i].radius_m, first.surfels[i].radius_m);
  }
}

TEST(BuildSurfaces, SaysWhenThereIsNothingToMap) {
  const auto none = BuildSurfaces({}, SurfaceOptions(), {});
  ASSERT_FALSE(none.ok());
  EXPECT_EQ(none.status().code(), Status::Code::kInsufficientData);

  RegisteredScan of_the_vehicle_only;
  of_the_vehicle_only.points.resize(100);
  const auto vehicle = BuildSurfaces({of_the_vehicle_only}, SurfaceOptions(), {});
  ASSERT_FALSE(vehicle.ok());
  EXPECT_EQ(vehicle.status().code(), Status::Code::kInsufficientData);
}

TEST(BuildSurfaces, RefusesAnOptionOutsideItsBound) {
  SurfaceOptions options;
  options.surfels.coarsest_voxel_m = -1.0;
  const auto surfaces = BuildSurfaces({}, options, {});
  ASSERT_FALSE(surfaces.ok());
  EXPECT_EQ(surfaces.status().code(), Status::Code::kInvalidArgument);
  EXPECT_NE(surfaces.status().message().find("surfels.coarsest_voxel_m"), std::string::npos);
}

TEST(BuildSurfaces, StopsOnRequest) {
  StreetLidar lidar;
  lidar.num_scans = 3;
  const StreetRecording recording = RecordStreet(AnalyticStreet(), lidar);
  const auto stopped =
      BuildSurfaces(recording.scans, SurfaceOptions(),
                    [](const Progress& progress) { return progress.fraction <= 0.0; });
  ASSERT_FALSE(stopped.ok());
  EXPECT_EQ(stopped.status().code(), Status::Code::kCancelled);
}

}  // namespace
}  // namespace scenecalib
