#include "scenecalib/tracking/track_extension.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "scenecalib/tracking/camera_tracker.h"
#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

using testing::HitPlanes;
using testing::MakePinhole;
using testing::RenderPlanes;
using testing::Texture;
using testing::TexturedPlane;

constexpr int kNumImages = 28;
constexpr double kWallM = 12.0;
/// More than from one end to the other of what one reference view may be compared with.
constexpr double kTooMuchGrowth = 9.0;

/// Fine detail near by, coarse detail from afar.
std::vector<TexturedPlane> Wall() {
  return {
      {{0, 0, kWallM}, Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(), Texture(4, 0.12, 3.0)}};
}

Timestamp Stamp(int i) { return 1'000'000'000 + i * 100'000'000LL; }
int IndexOf(Timestamp stamp_ns) { return static_cast<int>((stamp_ns - Stamp(0)) / 100'000'000); }

/// Straight towards the wall, by the same share of what is left in every image; down to a
/// thirteenth.
double RangeM(int i) { return kWallM * std::pow(1.0 / 13.0, i / (kNumImages - 1.0)); }
Rigid3 MapFromCamera(int i) {
  return {Eigen::Quaterniond::Identity(), {0.0, 0.0, kWallM - RangeM(i)}};
}

CameraModelPtr Camera() {
  static const CameraModelPtr model = MakePinhole(360, 280, 220.0);
  return model;
}

std::vector<Track> TrackTheWall(double max_view_sigma_px, double max_end_sigma_px = 10.0) {
  static std::vector<cv::Mat> images;
  for (int i = static_cast<int>(images.size()); i < kNumImages; ++i) {
    images.push_back(RenderPlanes(Wall(), *Camera(), MapFromCamera(i), 1.0, i + 1));
  }
  TrackingOptions options;
  options.detection.max_features = 200;
  options.registration.max_view_sigma_px = max_view_sigma_px;
  options.registration.max_end_sigma_px = max_end_sigma_px;
  CameraTracker tracker("cam", Camera(), options);
  for (int i = 0; i < kNumImages; ++i) {
    EXPECT_TRUE(tracker.AddImage({Stamp(i), images[static_cast<std::size_t>(i)], {}}).ok());
  }
  return tracker.Segment().tracks;
}

/// By how much a track's point grows from its first to its last sighting.
double Growth(const Track& track) {
  return RangeM(IndexOf(track.observations.front().stamp_ns)) /
         RangeM(IndexOf(track.observations.back().stamp_ns));
}

int NumBeyond(const std::vector<Track>& tracks, double growth) {
  return static_cast<int>(std::count_if(
      tracks.begin(), tracks.end(), [&](const Track& track) { return Growth(track) > growth; }));
}

TEST(TrackExtension, TakesANearerViewWhereTheScaleChanges) {
  const std::vector<Track> through_views = TrackTheWall(0.06);
  const std::vector<Track> one_view = TrackTheWall(0.0);
  EXPECT_EQ(NumBeyond(one_view, kTooMuchGrowth), 0);
  EXPECT_GT(NumBeyond(through_views, kTooMuchGrowth), 5);
}

TEST(TrackExtension, EndsWhereTheFarEndIsUncertainAsTheNearOneSeesIt) {
  const std::vector<Track> strict = TrackTheWall(0.06, 0.18);
  EXPECT_GT(strict.size(), 50U);
  EXPECT_LT(NumBeyond(strict, kTooMuchGrowth), NumBeyond(TrackTheWall(0.06), kTooMuchGrowth));
}

TEST(TrackExtension, StaysOnTheScenePointThroughNewViewsAndSaysHowCertain) {
  int num_judged = 0;
  for (const Track& track : TrackTheWall(0.06)) {
    if (Growth(track) < kTooMuchGrowth) continue;
    const TrackObservation& reference =
        track.observations[static_cast<std::size_t>(track.reference)];
    const auto hit =
        HitPlanes(Wall(), *Camera(), MapFromCamera(IndexOf(reference.stamp_ns)), reference.pixel);
    ASSERT_TRUE(hit.has_value());
    for (const TrackObservation& observation : track.observations) {
      const auto truth = Camera()->Project(MapFromCamera(IndexOf(observation.stamp_ns)).Inverse() *
                                           hit->point_in_map_m);
      ASSERT_TRUE(truth.has_value());
      const Eigen::Vector2d error = observation.pixel - *truth;
      EXPECT_LT(error.norm(), 0.5);
      // Five deviations of both views.
      const Eigen::Matrix2d covariance = observation.covariance_px2 + reference.covariance_px2;
      EXPECT_LT(error.dot(covariance.inverse() * error), 60.0);
    }
    ++num_judged;
  }
  EXPECT_GT(num_judged, 5);
}

}  // namespace
}  // namespace scenecalib
