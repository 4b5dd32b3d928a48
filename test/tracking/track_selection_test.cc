#include "scenecalib/tracking/track_selection.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "scenecalib/base/random.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

constexpr int kWidth_px = 800;
constexpr int kHeight_px = 600;

TEST(TrackSelection, TheLongestOfEveryCornerOfTheImageComeFirst) {
  std::vector<TrackSummary> tracks;
  for (std::size_t views = 3; views < 13; ++views) {
    tracks.push_back({0, {50.0, 50.0}, views});
    tracks.push_back({0, {750.0, 550.0}, views + 20});
  }
  const auto chosen = SelectSpread(tracks, 4, 3, kWidth_px, kHeight_px);
  EXPECT_EQ(chosen, (std::vector<std::size_t>{16, 17, 18, 19}));
}

TEST(TrackSelection, EverySecondOfTheDriveHasItsShare) {
  Random random(1);
  std::vector<TrackSummary> tracks;
  for (int i = 0; i < 900; ++i) {
    const int second = i % 9 == 0 ? 1 : 0;  // far fewer in the later one
    tracks.push_back({second * 1000000000LL,
                      {random.Uniform(0.0, kWidth_px - 1.0), random.Uniform(0.0, kHeight_px - 1.0)},
                      static_cast<std::size_t>(random.Uniform(3.0, 20.0))});
  }
  const auto chosen = SelectSpread(tracks, 128, 3, kWidth_px, kHeight_px);
  ASSERT_EQ(chosen.size(), 128U);
  EXPECT_TRUE(std::is_sorted(chosen.begin(), chosen.end()));
  const auto late = std::count_if(chosen.begin(), chosen.end(),
                                  [&](std::size_t i) { return tracks[i].stamp_ns > 0; });
  EXPECT_GT(late, 40) << "of 128, where one in nine tracks is late";
}

CameraModelPtr CameraOfFocalLength(double focal_px) {
  CameraIntrinsics intrinsics;
  intrinsics.model = "plumb_bob";
  intrinsics.width_px = kWidth_px;
  intrinsics.height_px = kHeight_px;
  intrinsics.focal_px = {focal_px, focal_px};
  intrinsics.principal_point_px = {400.0, 300.0};
  intrinsics.distortion = {0.0, 0.0, 0.0, 0.0, 0.0};
  const auto model = CreateCameraModel(intrinsics);
  return model.ok() ? *model : nullptr;
}

TEST(TrackSelection, LongRecordingsAndNarrowCamerasHaveMoreTracks) {
  // From corner to corner 90 degrees, and 23.
  const CameraModelPtr ordinary = CameraOfFocalLength(500.0);
  const CameraModelPtr narrow = CameraOfFocalLength(2500.0);
  const CameraModelPtr between = CameraOfFocalLength(900.0);
  ASSERT_TRUE(ordinary && narrow && between);
  EXPECT_EQ(TrackBudget(1000, *ordinary, 2.0), 1000U);
  EXPECT_EQ(TrackBudget(1000, *ordinary, 10.0), 1000U);
  EXPECT_EQ(TrackBudget(1000, *ordinary, 25.0), 2500U);
  EXPECT_EQ(TrackBudget(1000, *ordinary, 300.0), 3000U);
  EXPECT_EQ(TrackBudget(1000, *narrow, 10.0), 2000U);
  EXPECT_EQ(TrackBudget(1000, *narrow, 300.0), 6000U);
  EXPECT_GT(TrackBudget(1000, *between, 10.0), 1100U);
  EXPECT_LT(TrackBudget(1000, *between, 10.0), 1700U);
  EXPECT_EQ(TrackBudget(0, *narrow, 300.0), 0U);
}

TEST(TrackSelection, TheShortestGoWhereTheOthersAreEnough) {
  std::vector<Track> tracks;
  for (const int length : {3, 5, 3, 4, 6}) {
    Track track;
    track.id = static_cast<std::int64_t>(tracks.size());
    const double variance_px2 = 0.01 * (1.0 + static_cast<double>(track.id));
    track.observations.resize(static_cast<std::size_t>(length),
                              {0, {0.0, 0.0}, variance_px2 * Eigen::Matrix2d::Identity()});
    tracks.push_back(track);
  }
  const auto left_of = [&tracks](std::size_t enough_observations) {
    std::vector<Track> kept = tracks;
    DropShortest(enough_observations, &kept);
    std::vector<std::int64_t> ids;
    for (const Track& track : kept) ids.push_back(track.id);
    return ids;
  };
  using Ids = std::vector<std::int64_t>;
  EXPECT_EQ(left_of(100), (Ids{0, 1, 2, 3, 4}));
  EXPECT_EQ(left_of(19), (Ids{0, 1, 2, 3, 4}));  // without any of three they are 18
  EXPECT_EQ(left_of(18), (Ids{0, 1, 3, 4}));     // the less certain of the two of three
  EXPECT_EQ(left_of(15), (Ids{1, 3, 4}));
  EXPECT_EQ(left_of(12), (Ids{1, 3, 4}));  // without that of four they are 11
  EXPECT_EQ(left_of(11), (Ids{1, 4}));
}

TEST(TrackSelection, ShortTracksAreNotTakenHoweverFewThereAre) {
  const std::vector<TrackSummary> tracks = {{0, {10.0, 10.0}, 2}, {0, {20.0, 10.0}, 3}};
  EXPECT_EQ(SelectSpread(tracks, 10, 3, kWidth_px, kHeight_px), (std::vector<std::size_t>{1}));
  EXPECT_TRUE(SelectSpread({}, 10, 3, kWidth_px, kHeight_px).empty());
}

}  // namespace
}  // namespace scenecalib
