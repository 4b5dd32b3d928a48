#include "scenecalib/association/track_association.h"

#include <gtest/gtest.h>

#include <cmath>

#include "scenecalib/geometry/so3.h"
#include "testing/canyon_scene.h"

namespace scenecalib {
namespace {

TEST(ScoreBundle, AgreesWithEquationsFiveToEightByHand) {
  const AssociationGates gates{0.2, 0.1};
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d tilted(std::sin(0.2), 0.0, std::cos(0.2));  // one sigma_theta away
  const BundleScores scores =
      ScoreBundle({{0, 0, 0}, {1, 0, 0.1}, {0, 0, 0}}, {up, up, tilted}, gates);
  const double one_sigma = std::exp(-0.5);
  EXPECT_EQ(scores.best, 0);
  EXPECT_NEAR(scores.theta, (1.0 + one_sigma) / 2.0, 1e-6);
  // The second point lies one sigma_d above the first, the third in its plane.
  EXPECT_NEAR(scores.d, (one_sigma + 1.0) / 2.0, 1e-6);
}

TEST(ScoreBundle, PicksThePlaneThatMostNormalsAgreeWith) {
  const AssociationGates gates{0.2, 0.1};
  const Eigen::Vector3d side = Eigen::Vector3d::UnitX();
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  const BundleScores scores = ScoreBundle({{0, 0, 0}, {0, 0, 0}, {1, 0, 0}}, {side, up, up}, gates);
  EXPECT_NE(scores.best, 0);
}

class AssociateTracksInCanyon : public ::testing::Test {
 protected:
  AssociateTracksInCanyon() { testing::AddCanyonSurfaces(40.0, &map_); }

  TrackAssociation Associate(const std::vector<Ray>& bundle) const {
    const RayCaster caster = RayCaster::Create(map_).value();
    return AssociateTracks({bundle}, caster, {0.17, 0.06}, {})[0];
  }

  /// Rays from a camera that moves along x to a point.
  static std::vector<Ray> Towards(const Eigen::Vector3d& point, double spread_m) {
    std::vector<Ray> rays;
    for (int i = 0; i < 6; ++i) {
      const Eigen::Vector3d origin(0.5 * i, 0.0, 0.0);
      const Eigen::Vector3d aim = point + Eigen::Vector3d(spread_m * (i % 2), 0.0, 0.0);
      rays.push_back({origin, (aim - origin).normalized()});
    }
    return rays;
  }

  SceneMap map_;
};

TEST_F(AssociateTracksInCanyon, TiesABundleToTheSurfaceItMeets) {
  const TrackAssociation ground = Associate(Towards({8.0, 1.0, -2.0}, 0.0));
  ASSERT_TRUE(ground.accepted());
  EXPECT_EQ(ground.kind, SurfaceKind::kGround);
  EXPECT_NEAR(std::abs(ground.normal_in_map.z()), 1.0, 1e-6);
  EXPECT_NEAR(ground.point_in_map_m.x(), 8.0, 1e-3);
  const TrackAssociation wall = Associate(Towards({8.0, 9.0, 1.0}, 0.0));
  ASSERT_TRUE(wall.accepted());
  EXPECT_EQ(wall.kind, SurfaceKind::kSurfel);
}

TEST_F(AssociateTracksInCanyon, RejectsRaysIntoTheSky) {
  EXPECT_EQ(Associate(Towards({8.0, 0.0, 40.0}, 0.0)).outcome, AssociationOutcome::kTooFewHits);
}

TEST_F(AssociateTracksInCanyon, RejectsBundlesThatMeetDifferentSurfaces) {
  std::vector<Ray> mixed = Towards({8.0, 1.0, -2.0}, 0.0);
  const std::vector<Ray> wall = Towards({8.0, 9.0, 1.0}, 0.0);
  for (std::size_t i = 0; i < mixed.size(); i += 2) mixed[i] = wall[i];
  EXPECT_EQ(Associate(mixed).outcome, AssociationOutcome::kNormalsDisagree);
}

TEST_F(AssociateTracksInCanyon, RejectsSurfacesThatAreNotPlanar) {
  for (Surfel& surfel : map_.surfels) surfel.planar = false;
  EXPECT_EQ(Associate(Towards({8.0, 9.0, 1.0}, 0.0)).outcome, AssociationOutcome::kNotPlanar);
}

TEST_F(AssociateTracksInCanyon, RejectsGrazingViews) {
  EXPECT_EQ(Associate(Towards({60.0, 0.0, -2.0}, 0.0)).outcome, AssociationOutcome::kGrazing);
}

TEST_F(AssociateTracksInCanyon, ReasonsHaveNames) {
  for (int i = 0; i < kNumAssociationOutcomes; ++i) {
    EXPECT_NE(ToString(static_cast<AssociationOutcome>(i)), "unknown");
  }
}

}  // namespace
}  // namespace scenecalib
