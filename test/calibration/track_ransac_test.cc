#include "scenecalib/calibration/track_ransac.h"

#include <tbb/global_control.h>

#include "calibration/downward_rig.h"
#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

constexpr int kNumTracks = 120;
constexpr int kTermsPerTrack = 3;
constexpr double kNoisePx = 0.1;

/// Tracks on the ground below a camera that drives over it at different heights; every sixth one
/// follows something else.
class TrackRansacTest : public testing::DownwardRig {
 protected:
  TrackRansacTest() {
    problem_.cameras = &cameras_;
    problem_.correction = &no_correction_;
    problem_.residual_sigma = kNoisePx;
    problem_.priors.resize(1);
    problem_.priors[0].initial_lidar_from_camera = cameras_[0].base_lidar_from_camera;
    Random random(5);
    for (int track = 0; track < kNumTracks; ++track) AddTrack(track, &random);
  }

  static bool IsWrong(int track) { return track % 6 == 0; }

  void AddTrack(int track, Random* random) {
    const Eigen::Vector3d point(random->Uniform(-1.0, 1.0), random->Uniform(-1.0, 1.0), 0.0);
    const Eigen::Vector2d slip(random->Uniform(5.0, 40.0), random->Uniform(5.0, 40.0));
    TransferTerm term;
    term.track = track;
    const auto look = [&](TransferView* view) {
      view->map_from_lidar.translation = {random->Uniform(-0.5, 0.5), random->Uniform(-0.5, 0.5),
                                          random->Uniform(2.0, 4.0)};
      view->pixel = See(cameras_[0], view->map_from_lidar.translation, point) +
                    kNoisePx * Eigen::Vector2d(random->Gaussian(), random->Gaussian());
    };
    look(&term.source);
    for (int k = 0; k < kTermsPerTrack; ++k) {
      look(&term.target);
      if (IsWrong(track)) term.target.pixel += (k + 1) * slip;
      problem_.terms.push_back(term);
    }
  }

  /// Puts the camera off the pose that the pixels were made with.
  void Disturb() {
    cameras_[0].rotation_delta_rad = {0.01, -0.008, 0.012};
    cameras_[0].translation_delta_m = {0.04, 0.03, -0.05};
  }

  TrackRansacResult Run(std::uint64_t seed = 1) const {
    return RansacTracks(problem_, 0, options_, seed);
  }

  TrajectoryCorrection no_correction_;
  CalibrationProblem problem_;
  TrackRansacOptions options_;
};

TEST_F(TrackRansacTest, FindsThePoseThatMostTracksAgreeWith) {
  Disturb();
  const TrackRansacResult result = Run();
  EXPECT_TRUE(result.from_sample);
  EXPECT_LT(result.camera.rotation_delta_rad.norm(), 2e-3);
  EXPECT_LT(result.camera.translation_delta_m.norm(), 5e-3);
  ASSERT_EQ(result.is_inlier.size(), static_cast<std::size_t>(kNumTracks));
  int num_wrong_kept = 0;
  int num_right_dropped = 0;
  for (int track = 0; track < kNumTracks; ++track) {
    const bool is_inlier = result.is_inlier[static_cast<std::size_t>(track)];
    num_wrong_kept += is_inlier && IsWrong(track) ? 1 : 0;
    num_right_dropped += !is_inlier && !IsWrong(track) ? 1 : 0;
  }
  EXPECT_EQ(num_wrong_kept, 0);
  EXPECT_LE(num_right_dropped, 4);
  EXPECT_EQ(result.num_inliers, std::count(result.is_inlier.begin(), result.is_inlier.end(), true));
}

TEST_F(TrackRansacTest, WithoutSamplesThePoseStaysAndJudges) {
  Disturb();
  options_.num_hypotheses = 0;
  const TrackRansacResult result = Run();
  EXPECT_FALSE(result.from_sample);
  EXPECT_EQ(result.camera.rotation_delta_rad, cameras_[0].rotation_delta_rad);
  EXPECT_LT(result.num_inliers, kNumTracks / 10) << "the pose is off by tens of pixels";
}

TEST_F(TrackRansacTest, ATranslationThatIsHeldIsNotMoved) {
  Disturb();
  problem_.free.translation = false;
  const TrackRansacResult result = Run();
  EXPECT_EQ(result.camera.translation_delta_m, cameras_[0].translation_delta_m);
  EXPECT_NE(result.camera.rotation_delta_rad, cameras_[0].rotation_delta_rad);
}

TEST_F(TrackRansacTest, ATrackThatCannotBeEvaluatedIsNoInlier) {
  // The second term of track 1 is seen from under the ground.
  problem_.terms[kTermsPerTrack + 1].target.map_from_lidar.translation.z() = -2.0;
  const TrackRansacResult result = Run();
  EXPECT_FALSE(result.is_inlier[1]);
  EXPECT_TRUE(result.is_inlier[2]);
}

TEST_F(TrackRansacTest, DependsOnTheSeedAndNotOnTheThreads) {
  Disturb();
  const TrackRansacResult many = Run();
  const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
  const TrackRansacResult alone = Run();
  EXPECT_EQ(many.camera.rotation_delta_rad, alone.camera.rotation_delta_rad);
  EXPECT_EQ(many.camera.translation_delta_m, alone.camera.translation_delta_m);
  EXPECT_EQ(many.is_inlier, alone.is_inlier);
  EXPECT_NE(Run(2).camera.rotation_delta_rad, alone.camera.rotation_delta_rad);
}

}  // namespace
}  // namespace scenecalib
