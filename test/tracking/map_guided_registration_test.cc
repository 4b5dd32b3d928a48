#include "scenecalib/tracking/map_guided_registration.h"

#include <gtest/gtest.h>
#include <tbb/task_arena.h>

#include "scenecalib/geometry/so3.h"
#include "scenecalib/tracking/reference_registration.h"
#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

using testing::HitPlanes;
using testing::MakePinhole;
using testing::RenderPlanes;
using testing::Texture;
using testing::TexturedPlane;

constexpr int kNumImages = 7;
constexpr int kReference = 3;

Timestamp Stamp(int i) { return 1'000'000'000 + i * 100'000'000LL; }

/// A camera that drives over a road it looks down on, so that the perspective across a patch is
/// strong, with tracks at known pixels.
struct RoadScene {
  std::vector<TexturedPlane> world;
  CameraModelPtr model = MakePinhole(400, 300, 220.0);
  std::map<Timestamp, Rigid3> map_from_camera;
  std::map<Timestamp, ImagePose> poses;
  std::map<Timestamp, cv::Mat> images;
  std::vector<Track> tracks;
  std::vector<TrackPlane> planes;

  /// Tracks are seen in images [first, last].
  RoadScene(double noise, int first, int last) {
    world.push_back(
        {{0, 1.5, 0}, Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitZ(), Texture(11, 0.2, 1.0)});
    for (int i = 0; i < kNumImages; ++i) {
      const double t = 0.12 * i;
      const Rigid3 pose(ExpSo3({-0.35 + 0.02 * std::sin(i), 0.03 * t, 0.0}), {0.1 * t, 0.0, t});
      map_from_camera[Stamp(i)] = pose;
      poses[Stamp(i)] = pose;
      cv::Mat& rendered = Rendered()[{noise, i}];  // rendering is most of these tests' time
      if (rendered.empty()) rendered = RenderPlanes(world, *model, pose, noise, i + 1);
      images[Stamp(i)] = rendered;
    }
    for (int y = 120; y <= 270; y += 15) {
      for (int x = 40; x <= 360; x += 16) AddTrack({x, y}, first, last);
    }
  }

  static std::map<std::pair<double, int>, cv::Mat>& Rendered() {
    static std::map<std::pair<double, int>, cv::Mat> rendered;
    return rendered;
  }

  std::optional<Eigen::Vector2d> TruePixel(const Eigen::Vector2d& reference_px, int i) const {
    const auto hit = HitPlanes(world, *model, map_from_camera.at(Stamp(kReference)), reference_px);
    if (!hit) return std::nullopt;
    return model->Project(map_from_camera.at(Stamp(i)).Inverse() * hit->point_in_map_m);
  }

  void AddTrack(const Eigen::Vector2d& reference_px, int first, int last) {
    Track track;
    track.id = static_cast<std::int64_t>(tracks.size());
    for (int i = first; i <= last; ++i) {
      const auto pixel = TruePixel(reference_px, i);
      if (!pixel) return;
      if (i == kReference) track.reference = static_cast<int>(track.observations.size());
      TrackObservation observation;
      observation.stamp_ns = Stamp(i);
      // The tracker's pixels are a little off.
      observation.pixel =
          i == kReference ? reference_px : Eigen::Vector2d(*pixel + Eigen::Vector2d(0.15, -0.2));
      track.observations.push_back(observation);
    }
    tracks.push_back(track);
    planes.push_back({world[0].origin_in_map_m, world[0].normal()});
  }

  MapGuidedTracks Register(const MapGuidedOptions& options) const {
    return RegisterThroughMap(tracks, planes, *model, poses, images, options);
  }

  /// Errors against the truth, along the flow and in all.
  struct Errors {
    double mean_along_px = 0.0;
    double median_px = 0.0;
    double mean_chi_squared = 0.0;  ///< per pixel coordinate
    int count = 0;
  };
  Errors Evaluate(const std::vector<Track>& found) const {
    Errors errors;
    std::vector<double> sizes;
    for (const Track& track : found) {
      if (track.observations.empty()) continue;
      const TrackObservation& reference = track.observations[track.reference];
      for (const TrackObservation& observation : track.observations) {
        if (observation.stamp_ns == reference.stamp_ns) continue;
        const int i = static_cast<int>((observation.stamp_ns - Stamp(0)) / 100'000'000);
        const auto truth = TruePixel(reference.pixel, i);
        if (!truth) continue;
        const Eigen::Vector2d error = observation.pixel - *truth;
        Eigen::Vector2d flow = (*truth - reference.pixel).normalized();
        if (i < kReference) flow = -flow;
        errors.mean_along_px += error.dot(flow);
        errors.mean_chi_squared +=
            0.5 *
            error.dot((observation.covariance_px2 + reference.covariance_px2).inverse() * error);
        sizes.push_back(error.norm());
      }
    }
    errors.count = static_cast<int>(sizes.size());
    errors.mean_along_px /= errors.count;
    errors.mean_chi_squared /= errors.count;
    std::sort(sizes.begin(), sizes.end());
    errors.median_px = sizes[sizes.size() / 2];
    return errors;
  }
};

/// What an affine window makes of the same tracks.
std::vector<Track> RegisterAffine(const RoadScene& scene) {
  std::vector<LiveTrack> live;
  for (const Track& track : scene.tracks) {
    LiveTrack one;
    one.id = track.id;
    for (const TrackObservation& observation : track.observations) {
      const int i = static_cast<int>((observation.stamp_ns - Stamp(0)) / 100'000'000);
      // The true first-order warp, as a perfect live tracker would hand on.
      Eigen::Matrix2d affine;
      const Eigen::Vector2d center = track.observations[track.reference].pixel;
      for (int k = 0; k < 2; ++k) {
        const Eigen::Vector2d step = Eigen::Vector2d::Unit(k);
        affine.col(k) =
            0.5 * (*scene.TruePixel(center + step, i) - *scene.TruePixel(center - step, i));
      }
      one.observations.push_back({observation.stamp_ns, observation.pixel, affine});
    }
    live.push_back(one);
  }
  RegistrationOptions options;
  const cv::Mat mask(300, 400, CV_8UC1, cv::Scalar(255));
  std::vector<Track> tracks;
  for (const RegisteredTrack& registered : RegisterAgainstReference(
           live, scene.images, mask, MeasureImageQuality(scene.images.begin()->second, mask), 3,
           options))
    tracks.push_back(registered.track);
  return tracks;
}

TEST(WarpThroughPlane, AgreesWithTracingEveryPixelOfThePatch) {
  const RoadScene scene(0.0, 1, 5);
  const Eigen::Vector2d reference_px(150, 200);
  const auto warp =
      WarpThroughPlane(*scene.model, scene.planes[0], scene.map_from_camera.at(Stamp(kReference)),
                       reference_px, scene.map_from_camera.at(Stamp(6)), 10);
  ASSERT_TRUE(warp);
  for (int y = -10; y <= 10; y += 5) {
    for (int x = -10; x <= 10; x += 5) {
      const auto truth = scene.TruePixel(reference_px + Eigen::Vector2d(x, y), 6);
      ASSERT_TRUE(truth);
      // What remains is the perspective's third order.
      EXPECT_LT(((*warp)({x, y}) - *truth).norm(), 0.05) << x << ", " << y;
    }
  }
  EXPECT_LT(((*warp)({0, 0}) - *scene.TruePixel(reference_px, 6)).norm(), 1e-9);
}

TEST(WarpThroughPlane, SaysNothingWhenTheRayMissesThePlane) {
  const RoadScene scene(0.0, 1, 5);
  const Rigid3 pose = scene.map_from_camera.at(Stamp(kReference));
  EXPECT_FALSE(WarpThroughPlane(*scene.model, scene.planes[0], pose, {200, 15}, pose, 10))
      << "the sky";
  Rigid3 ahead = pose;
  ahead.translation.z() += 50.0;
  EXPECT_FALSE(WarpThroughPlane(*scene.model, scene.planes[0], pose, {200, 250}, ahead, 10))
      << "a view that has passed the point";
}

TEST(RegisterThroughMap, HasNoBiasAlongTheFlowOnASlantedPlane) {
  const RoadScene scene(2.0, 0, 6);
  MapGuidedOptions options;
  options.max_extension = 0;
  const auto guided = scene.Evaluate(scene.Register(options).tracks);
  EXPECT_GT(guided.count, 500);
  EXPECT_LT(std::abs(guided.mean_along_px), 0.01);
  EXPECT_LT(guided.median_px, 0.05);
  // The covariance is neither far too small nor far too large.
  EXPECT_LT(guided.mean_chi_squared, 3.0);
  EXPECT_GT(guided.mean_chi_squared, 0.2);
}

TEST(RegisterThroughMap, IsBetterThanAnAffineWindow) {
  const RoadScene scene(0.0, 0, 6);
  MapGuidedOptions options;
  options.max_extension = 0;
  const auto guided = scene.Evaluate(scene.Register(options).tracks);
  const auto affine = scene.Evaluate(RegisterAffine(scene));
  EXPECT_LT(guided.median_px, 0.5 * affine.median_px);
  EXPECT_LT(std::abs(guided.mean_along_px), std::abs(affine.mean_along_px));
}

TEST(RegisterThroughMap, ExtendsTracksAtBothEnds) {
  const RoadScene scene(2.0, 2, 4);
  const MapGuidedTracks found = scene.Register({});
  EXPECT_GT(found.num_observations_added, 300);
  EXPECT_LT(scene.Evaluate(found.tracks).median_px, 0.06);
  for (const Track& track : found.tracks) {
    for (std::size_t i = 1; i < track.observations.size(); ++i) {
      EXPECT_GT(track.observations[i].stamp_ns, track.observations[i - 1].stamp_ns);
    }
    if (!track.observations.empty()) {
      EXPECT_EQ(track.observations[track.reference].stamp_ns, Stamp(kReference));
    }
  }
}

TEST(RegisterThroughMap, ToleratesACalibrationThatIsStillOff) {
  RoadScene scene(2.0, 0, 6);
  const Rigid3 error(ExpSo3({0.004, -0.005, 0.003}), {0.03, -0.02, 0.03});
  auto poses = scene.poses;
  for (auto& [stamp_ns, pose] : poses) pose = pose.map_from_camera() * error;
  const auto found = RegisterThroughMap(scene.tracks, scene.planes, *scene.model, poses,
                                        scene.images, MapGuidedOptions());
  EXPECT_LT(found.num_tracks_dropped, static_cast<int>(scene.tracks.size()) / 10);
  const auto errors = scene.Evaluate(found.tracks);
  EXPECT_LT(errors.median_px, 0.06);
  EXPECT_LT(std::abs(errors.mean_along_px), 0.02);
}

TEST(RegisterThroughMap, DropsWhatDoesNotLookAsPredicted) {
  RoadScene scene(2.0, 0, 6);
  // Something else stands in one image; and one track's plane is far from the truth.
  scene.images[Stamp(5)] = testing::Render(400, 300, Texture(77, 10, 40));
  for (TrackPlane& plane : scene.planes) {
    if (&plane == &scene.planes[0]) plane.normal_in_map = Eigen::Vector3d(1, 0.05, 0).normalized();
  }
  const MapGuidedTracks found = scene.Register({});
  int num_in_image = 0;
  for (const Track& track : found.tracks) {
    for (const auto& observation : track.observations) {
      num_in_image += observation.stamp_ns == Stamp(5) ? 1 : 0;
    }
  }
  EXPECT_LT(num_in_image, static_cast<int>(scene.tracks.size()) / 20);
  EXPECT_GT(found.num_observations_dropped, static_cast<int>(scene.tracks.size()) * 9 / 10);
}

TEST(RegisterThroughMap, DropsTracksWithoutPoseImageOrObservations) {
  RoadScene scene(2.0, 0, 6);
  scene.tracks[0].observations.clear();
  auto poses = scene.poses;
  poses.erase(Stamp(kReference));
  const auto found = RegisterThroughMap(scene.tracks, scene.planes, *scene.model, poses,
                                        scene.images, MapGuidedOptions());
  EXPECT_EQ(found.num_tracks_dropped, static_cast<int>(scene.tracks.size()));
  ASSERT_EQ(found.tracks.size(), scene.tracks.size());
  EXPECT_EQ(found.tracks[3].id, scene.tracks[3].id);
  EXPECT_TRUE(scene.Register({}).tracks[0].observations.empty());
}

TEST(RegisterThroughMap, DoesNotDependOnTheNumberOfThreads) {
  const RoadScene scene(2.0, 0, 6);
  const MapGuidedTracks many = scene.Register({});
  MapGuidedTracks one;
  tbb::task_arena(1).execute([&] { one = scene.Register({}); });
  ASSERT_EQ(one.tracks.size(), many.tracks.size());
  for (std::size_t i = 0; i < one.tracks.size(); ++i) {
    ASSERT_EQ(one.tracks[i].observations.size(), many.tracks[i].observations.size());
    for (std::size_t k = 0; k < one.tracks[i].observations.size(); ++k) {
      EXPECT_EQ(one.tracks[i].observations[k].pixel, many.tracks[i].observations[k].pixel);
    }
  }
}

TEST(MapGuidedOptions, DefaultsAreWithinTheirBounds) {
  EXPECT_TRUE(CheckOptions(MapGuidedOptions()).ok());
}

}  // namespace
}  // namespace scenecalib
