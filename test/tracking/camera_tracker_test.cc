#include "scenecalib/tracking/camera_tracker.h"

#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>

#include "scenecalib/base/options.h"
#include "scenecalib/geometry/so3.h"
#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

using testing::HitPlanes;
using testing::MakeFisheye;
using testing::MakePinhole;
using testing::RenderPlanes;
using testing::Texture;
using testing::TexturedPlane;

constexpr Timestamp kPeriodNs = 100'000'000;
constexpr int kNumImages = 14;

TrackingOptions SmallOptions() {
  TrackingOptions options;
  options.detection.max_features = 250;
  return options;
}

/// A road 1.5 m below the camera and a facade to the right, slanted to the direction of travel.
std::vector<TexturedPlane> Street() {
  const Eigen::Vector3d along = Eigen::Vector3d(0.2, 0.0, 1.0).normalized();
  return {{{0, 1.5, 0}, Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitZ(), Texture(1, 0.25, 2.0)},
          {{2.5, 0, 0}, along, Eigen::Vector3d::UnitY(), Texture(2, 0.25, 2.0)}};
}

/// Drives forward and a little sideways while pitching and turning.
Rigid3 MapFromCamera(int i) {
  const double t = 0.1 * i;
  return {ExpSo3({0.01 * std::sin(9.0 * t), 0.08 * t, 0.0}), {0.2 * t, 0.0, 4.0 * t}};
}

Timestamp Stamp(int i) { return 1'000'000'000 + i * kPeriodNs; }

/// A drive through the street, made once.
const std::vector<cv::Mat>& StreetImages(const CameraModelPtr& model) {
  static std::map<std::string, std::vector<cv::Mat>> cache;
  auto& images = cache[model->name()];
  for (int i = static_cast<int>(images.size()); i < kNumImages; ++i) {
    images.push_back(RenderPlanes(Street(), *model, MapFromCamera(i), 2.0, i + 1));
  }
  return images;
}

CameraModelPtr Pinhole() {
  static const CameraModelPtr model = MakePinhole(400, 300, 220.0);
  return model;
}

/// Distance of every observation from where the reference's scene point truly appears.
std::vector<double> TrueErrorsPx(const CameraModel& model, const std::vector<Track>& tracks) {
  std::vector<double> errors_px;
  for (const Track& track : tracks) {
    const TrackObservation& reference = track.observations[track.reference];
    const auto index = [](Timestamp stamp) {
      return static_cast<int>((stamp - Stamp(0)) / kPeriodNs);
    };
    const auto hit =
        HitPlanes(Street(), model, MapFromCamera(index(reference.stamp_ns)), reference.pixel);
    if (!hit) continue;
    for (const TrackObservation& observation : track.observations) {
      if (observation.stamp_ns == reference.stamp_ns) continue;
      const auto truth =
          model.Project(MapFromCamera(index(observation.stamp_ns)).Inverse() * hit->point_in_map_m);
      if (truth) errors_px.push_back((*truth - observation.pixel).norm());
    }
  }
  return errors_px;
}

double Quantile(std::vector<double> values, double quantile) {
  std::sort(values.begin(), values.end());
  return values.empty() ? 0.0 : values[static_cast<std::size_t>(quantile * (values.size() - 1))];
}

CameraSegment TrackStreet(const CameraModelPtr& model, const TrackingOptions& options) {
  CameraTracker tracker("cam", model, options);
  for (int i = 0; i < kNumImages; ++i) {
    const auto frame = tracker.AddImage({Stamp(i), StreetImages(model)[i]});
    EXPECT_TRUE(frame.ok()) << frame.status().message();
  }
  return tracker.Segment();
}

TEST(CameraTracker, FollowsAStreetWithoutDrift) {
  const CameraSegment segment = TrackStreet(Pinhole(), SmallOptions());
  EXPECT_EQ(segment.num_images_in, kNumImages);
  EXPECT_EQ(segment.images.size(), static_cast<std::size_t>(kNumImages));
  EXPECT_TRUE(segment.warnings.empty());
  EXPECT_GT(segment.tracks.size(), 200U);
  const std::vector<double> errors_px = TrueErrorsPx(*Pinhole(), segment.tracks);
  EXPECT_GT(errors_px.size(), 1000U);
  EXPECT_LT(Quantile(errors_px, 0.5), 0.06);
  EXPECT_LT(Quantile(errors_px, 0.95), 0.4);
}

TEST(CameraTracker, TracksKeepTheContractOfTheirType) {
  const CameraSegment segment = TrackStreet(Pinhole(), SmallOptions());
  std::int64_t previous_id = -1;
  for (const Track& track : segment.tracks) {
    EXPECT_GT(track.id, previous_id);
    previous_id = track.id;
    ASSERT_GE(track.observations.size(), 3U);
    ASSERT_GE(track.reference, 0);
    ASSERT_LT(track.reference, static_cast<int>(track.observations.size()));
    for (std::size_t i = 0; i < track.observations.size(); ++i) {
      const TrackObservation& observation = track.observations[i];
      EXPECT_TRUE(Pinhole()->IsInImage(observation.pixel));
      EXPECT_EQ(segment.images.count(observation.stamp_ns), 1U);
      EXPECT_GT(observation.covariance_px2.determinant(), 0.0);
      if (i > 0) {
        EXPECT_GT(observation.stamp_ns, track.observations[i - 1].stamp_ns);
      }
    }
  }
}

TEST(CameraTracker, IsDeterministic) {
  const CameraSegment a = TrackStreet(Pinhole(), SmallOptions());
  const CameraSegment b = TrackStreet(Pinhole(), SmallOptions());
  ASSERT_EQ(a.tracks.size(), b.tracks.size());
  for (std::size_t i = 0; i < a.tracks.size(); ++i) {
    ASSERT_EQ(a.tracks[i].id, b.tracks[i].id);
    ASSERT_EQ(a.tracks[i].observations.size(), b.tracks[i].observations.size());
    for (std::size_t k = 0; k < a.tracks[i].observations.size(); ++k) {
      EXPECT_EQ(a.tracks[i].observations[k].pixel, b.tracks[i].observations[k].pixel);
    }
  }
}

TEST(CameraTracker, TracksAFisheyeInsideItsDomain) {
  const CameraModelPtr fisheye = MakeFisheye(400, 300, 110.0);
  const CameraSegment segment = TrackStreet(fisheye, SmallOptions());
  EXPECT_GT(segment.tracks.size(), 100U);
  EXPECT_LT(Quantile(TrueErrorsPx(*fisheye, segment.tracks), 0.5), 0.08);
}

TEST(CameraTracker, DropsWhatIsFixedToTheVehicle) {
  CameraTracker tracker("cam", Pinhole(), SmallOptions());
  const Texture bonnet(9, 8.0, 30.0);
  constexpr int kBonnetTop = 240;
  for (int i = 0; i < kNumImages; ++i) {
    cv::Mat image = StreetImages(Pinhole())[i].clone();
    for (int y = kBonnetTop; y < image.rows; ++y) {
      for (int x = 0; x < image.cols; ++x) image.at<uchar>(y, x) = testing::ToGrey(bonnet(x, y));
    }
    ASSERT_TRUE(tracker.AddImage({Stamp(i), image}).ok());
  }
  const CameraSegment segment = tracker.Segment();
  EXPECT_GT(segment.tracks.size(), 100U);
  int num_on_bonnet = 0;
  for (const Track& track : segment.tracks) {
    num_on_bonnet += track.observations[track.reference].pixel.y() > kBonnetTop ? 1 : 0;
  }
  EXPECT_EQ(num_on_bonnet, 0);
}

TEST(CameraTracker, DropsObjectsThatMoveAcrossTheEpipolarLines) {
  CameraTracker tracker("cam", Pinhole(), SmallOptions());
  const Texture object(9, 8.0, 30.0);
  const auto object_left_px = [](int i) { return 60.0 + 4.0 * i; };
  const auto object_top_px = [](int i) { return 60.0 + 2.5 * i; };
  constexpr double kObjectSizePx = 70.0;
  for (int i = 0; i < kNumImages; ++i) {
    cv::Mat image = StreetImages(Pinhole())[i].clone();
    for (int y = 0; y < image.rows; ++y) {
      for (int x = 0; x < image.cols; ++x) {
        const double u = x - object_left_px(i);
        const double v = y - object_top_px(i);
        if (u < 0 || v < 0 || u > kObjectSizePx || v > kObjectSizePx) continue;
        image.at<uchar>(y, x) = testing::ToGrey(object(u, v));
      }
    }
    ASSERT_TRUE(tracker.AddImage({Stamp(i), image}).ok());
  }
  int num_on_object = 0;
  for (const Track& track : tracker.Segment().tracks) {
    const TrackObservation& reference = track.observations[track.reference];
    const int i = static_cast<int>((reference.stamp_ns - Stamp(0)) / kPeriodNs);
    const double u = reference.pixel.x() - object_left_px(i);
    const double v = reference.pixel.y() - object_top_px(i);
    num_on_object += u > 5 && v > 5 && u < kObjectSizePx - 5 && v < kObjectSizePx - 5 ? 1 : 0;
  }
  EXPECT_LE(num_on_object, 2);
}

TEST(CameraTracker, ReportsBlackImagesAndGoesOn) {
  CameraTracker tracker("cam_left", Pinhole(), SmallOptions());
  const cv::Mat black(300, 400, CV_8UC1, cv::Scalar(0));
  for (int i = 0; i < kNumImages; ++i) {
    const bool is_black = i >= 4 && i < 7;
    ASSERT_TRUE(tracker.AddImage({Stamp(i), is_black ? black : StreetImages(Pinhole())[i]}).ok());
  }
  const CameraSegment segment = tracker.Segment();
  EXPECT_GT(segment.tracks.size(), 50U);
  ASSERT_EQ(segment.warnings.size(), 1U);
  EXPECT_EQ(segment.warnings[0], "cam_left: 3 of 14 images are black");
}

TEST(CameraTracker, SurvivesACameraThatIsAlwaysBlack) {
  CameraTracker tracker("cam", Pinhole(), SmallOptions());
  for (int i = 0; i < 5; ++i) {
    const auto frame = tracker.AddImage({Stamp(i), cv::Mat(300, 400, CV_8UC1, cv::Scalar(0))});
    ASSERT_TRUE(frame.ok());
    EXPECT_EQ(frame->num_new, 0);
  }
  const CameraSegment segment = tracker.Segment();
  EXPECT_TRUE(segment.tracks.empty());
  EXPECT_EQ(segment.warnings.size(), 2U);
}

TEST(CameraTracker, FollowsDarkImages) {
  CameraTracker tracker("cam", Pinhole(), SmallOptions());
  for (int i = 0; i < kNumImages; ++i) {
    cv::Mat dark;
    StreetImages(Pinhole())[i].convertTo(dark, CV_8UC1, 0.15);
    ASSERT_TRUE(tracker.AddImage({Stamp(i), dark}).ok());
  }
  const CameraSegment segment = tracker.Segment();
  EXPECT_GT(segment.tracks.size(), 150U);
  EXPECT_LT(Quantile(TrueErrorsPx(*Pinhole(), segment.tracks), 0.5), 0.12);
}

TEST(CameraTracker, SaysWhenItIsTooDark) {
  CameraTracker tracker("cam_rear", Pinhole(), SmallOptions());
  for (int i = 0; i < 6; ++i) {
    cv::Mat dark;
    StreetImages(Pinhole())[i].convertTo(dark, CV_8UC1, 0.033);
    ASSERT_TRUE(tracker.AddImage({Stamp(i), dark}).ok());
  }
  const CameraSegment segment = tracker.Segment();
  ASSERT_FALSE(segment.warnings.empty());
  EXPECT_EQ(segment.warnings.back().find("cam_rear: too dark: mean grey value"), 0U);
}

TEST(CameraTracker, LeavesOutWhatTheUserMasks) {
  constexpr int kSeenFromPx = 200;
  cv::Mat mask(300, 400, CV_8UC1, cv::Scalar(255));
  mask.colRange(0, kSeenFromPx).setTo(0);
  CameraTracker tracker("cam", Pinhole(), SmallOptions(), mask);
  mask.setTo(0);  // the tracker must not depend on the caller's
  for (int i = 0; i < kNumImages; ++i) {
    ASSERT_TRUE(tracker.AddImage({Stamp(i), StreetImages(Pinhole())[i]}).ok());
  }
  const CameraSegment segment = tracker.Segment();
  EXPECT_GT(segment.tracks.size(), 80U);
  for (const Track& track : segment.tracks) {
    for (const TrackObservation& observation : track.observations) {
      EXPECT_GE(observation.pixel.x(), kSeenFromPx);
    }
  }
}

TEST(CameraTracker, RefusesAMaskOfTheWrongSize) {
  CameraTracker tracker("cam", Pinhole(), SmallOptions(),
                        cv::Mat(299, 400, CV_8UC1, cv::Scalar(255)));
  const auto frame = tracker.AddImage({Stamp(0), StreetImages(Pinhole())[0]});
  ASSERT_FALSE(frame.ok());
  EXPECT_NE(frame.status().message().find("mask is 400x299"), std::string::npos);
}

TEST(CameraTracker, FindsFeaturesAgainBehindWhatHidThem) {
  CameraTracker tracker("cam", Pinhole(), SmallOptions());
  constexpr int kHidden = 6;
  const cv::Rect bar(120, 0, 60, 300);
  for (int i = 0; i < kNumImages; ++i) {
    cv::Mat image = StreetImages(Pinhole())[i].clone();
    if (i == kHidden) image(bar).setTo(110);
    ASSERT_TRUE(tracker.AddImage({Stamp(i), image}).ok());
  }
  const CameraSegment segment = tracker.Segment();
  int num_across = 0;
  for (const Track& track : segment.tracks) {
    bool before = false, during = false, after = false;
    for (const TrackObservation& observation : track.observations) {
      before |= observation.stamp_ns < Stamp(kHidden);
      during |= observation.stamp_ns == Stamp(kHidden);
      after |= observation.stamp_ns > Stamp(kHidden);
    }
    num_across += before && after && !during ? 1 : 0;
  }
  EXPECT_GE(num_across, 5);
  EXPECT_LT(Quantile(TrueErrorsPx(*Pinhole(), segment.tracks), 0.5), 0.06);
}

TEST(CameraTracker, FollowsThroughAJoltThatNothingForetold) {
  constexpr int kJolt = 6;
  CameraTracker tracker("cam", Pinhole(), SmallOptions());
  for (int i = 0; i < kJolt; ++i) {
    ASSERT_TRUE(tracker.AddImage({Stamp(i), StreetImages(Pinhole())[i]}).ok());
  }
  Rigid3 map_from_camera = MapFromCamera(kJolt);
  map_from_camera.rotation = map_from_camera.rotation * ExpSo3({0.08, 0.0, 0.0});  // 18 px
  const auto frame = tracker.AddImage(
      {Stamp(kJolt), RenderPlanes(Street(), *Pinhole(), map_from_camera, 2.0, kJolt + 1)});
  ASSERT_TRUE(frame.ok());
  EXPECT_GT(frame->num_tracked, 120);
}

TEST(CameraTracker, RefusesImagesOfTheWrongSizeTypeOrTime) {
  CameraTracker tracker("cam", Pinhole(), SmallOptions());
  const cv::Mat& image = StreetImages(Pinhole())[0];
  const auto size = tracker.AddImage({Stamp(0), cv::Mat(300, 401, CV_8UC1, cv::Scalar(0))});
  ASSERT_FALSE(size.ok());
  EXPECT_NE(size.status().message().find("401x300"), std::string::npos);
  EXPECT_FALSE(tracker.AddImage({Stamp(0), cv::Mat(300, 400, CV_16UC1, cv::Scalar(0))}).ok());
  EXPECT_FALSE(tracker.AddImage({Stamp(0), cv::Mat()}).ok());
  EXPECT_TRUE(tracker.AddImage({Stamp(1), image}).ok());
  EXPECT_FALSE(tracker.AddImage({Stamp(1), image}).ok()) << "repeated stamp";
  EXPECT_FALSE(tracker.AddImage({Stamp(0), image}).ok()) << "stamp runs backwards";
  EXPECT_TRUE(tracker.AddImage({Stamp(2), image}).ok()) << "a refused image changes nothing";
  EXPECT_EQ(tracker.Segment().num_images_in, 2);
}

TEST(CameraTracker, RefusesImagesWithoutAModel) {
  CameraTracker tracker("cam", nullptr, SmallOptions());
  const auto frame = tracker.AddImage({Stamp(0), cv::Mat(300, 400, CV_8UC1, cv::Scalar(0))});
  ASSERT_FALSE(frame.ok());
  EXPECT_NE(frame.status().message().find("no camera model"), std::string::npos);
  EXPECT_TRUE(tracker.Segment().tracks.empty());
}

TEST(CameraTracker, ForgetsTheOldestImagesAtItsBound) {
  TrackingOptions options = SmallOptions();
  options.buffer.max_images = 10;
  const CameraSegment segment = TrackStreet(Pinhole(), options);
  EXPECT_EQ(segment.images.size(), 10U);
  EXPECT_EQ(segment.num_images_dropped_at_bound, kNumImages - 10);
  EXPECT_EQ(segment.images.begin()->first, Stamp(kNumImages - 10));
  EXPECT_FALSE(segment.tracks.empty());
  for (const Track& track : segment.tracks) {
    EXPECT_GE(track.observations.front().stamp_ns, Stamp(kNumImages - 10));
  }
}

constexpr int kStop = 6;

/// The street, with a stand of `num_still` images with noise of their own after the sixth. In all
/// but the first and the last three of them something hides a part of the scene.
CameraSegment TrackStreetWithAStand(int num_still, const TrackingOptions& options,
                                    const cv::Rect& hidden = {}) {
  const Texture passing(11, 8.0, 30.0);
  CameraTracker tracker("cam", Pinhole(), options);
  Random random(5);
  for (int i = 0; i < kNumImages + num_still; ++i) {
    const bool is_still = i > kStop && i <= kStop + num_still;
    cv::Mat image = StreetImages(Pinhole())[is_still    ? kStop
                                            : i > kStop ? i - num_still
                                                        : i]
                        .clone();
    if (is_still) {
      for (int y = 0; y < image.rows; ++y) {
        for (int x = 0; x < image.cols; ++x) {
          const bool is_hidden =
              i > kStop + 3 && i <= kStop + num_still - 3 && hidden.contains(cv::Point(x, y));
          const double scene = is_hidden ? passing(x - 9.0 * i, y) : image.at<uchar>(y, x);
          image.at<uchar>(y, x) = testing::ToGrey(scene + 2.0 * random.Gaussian());
        }
      }
    }
    EXPECT_TRUE(tracker.AddImage({Stamp(i), image}).ok());
  }
  return tracker.Segment();
}

TEST(CameraTracker, AStandDoesNotPushTheDriveOutOfTheBuffer) {
  constexpr int kNumStill = 20;
  TrackingOptions options = SmallOptions();
  options.buffer.max_images = kNumImages + 1;
  const CameraSegment segment = TrackStreetWithAStand(kNumStill, options);
  EXPECT_EQ(segment.num_images_dropped_at_bound, 0);
  EXPECT_EQ(segment.num_images_still, kNumStill - 1) << "the last of them stays";
  EXPECT_EQ(segment.images.begin()->first, Stamp(0));
  EXPECT_EQ(segment.images.size(), static_cast<std::size_t>(kNumImages) + 1);
  int num_across = 0;
  for (const Track& track : segment.tracks) {
    for (const TrackObservation& o : track.observations) {
      ASSERT_EQ(segment.images.count(o.stamp_ns), 1U);
    }
    num_across += track.observations.front().stamp_ns < Stamp(6) &&
                          track.observations.back().stamp_ns > Stamp(6 + kNumStill)
                      ? 1
                      : 0;
  }
  EXPECT_GT(num_across, 50) << "tracks go on where the vehicle starts again";

  options.buffer.min_motion_px = 0.0;
  const CameraSegment all = TrackStreetWithAStand(kNumStill, options);
  EXPECT_EQ(all.num_images_still, 0);
  EXPECT_EQ(all.num_images_dropped_at_bound, kNumStill - 1);
}

TEST(CameraTracker, ABonnetBeforeAScreenfulThatCannotBeFollowedIsNoStand) {
  // Nothing above the bonnet is ever seen twice; on the bonnet everything is followed.
  CameraTracker tracker("cam", Pinhole(), SmallOptions());
  const int bonnet_row = Pinhole()->height_px() * 3 / 5;
  for (int i = 0; i < kNumImages; ++i) {
    cv::Mat image = StreetImages(Pinhole())[0].clone();
    const Texture passing(100 + static_cast<std::uint64_t>(i), 3.0, 12.0);
    for (int y = 0; y < bonnet_row; ++y) {
      for (int x = 0; x < image.cols; ++x) {
        image.at<uchar>(y, x) = testing::ToGrey(passing(x, y));
      }
    }
    ASSERT_TRUE(tracker.AddImage({Stamp(i), image}).ok());
  }
  const CameraSegment segment = tracker.Segment();
  EXPECT_EQ(segment.num_images_still, 0);
  EXPECT_EQ(segment.images.size(), static_cast<std::size_t>(kNumImages));
}

TEST(CameraTracker, FindsFeaturesAgainThatWereHiddenDuringAStand) {
  constexpr int kNumStill = 20;
  const cv::Rect hidden(230, 100, 120, 100);
  ASSERT_GT(kNumStill - 6, 2 * SmallOptions().flow.max_gap_images);
  const auto num_across = [&](const CameraSegment& segment) {
    int count = 0;
    for (const Track& track : segment.tracks) {
      const auto at_stop = std::find_if(
          track.observations.begin(), track.observations.end(),
          [](const TrackObservation& observation) { return observation.stamp_ns == Stamp(kStop); });
      if (at_stop == track.observations.end()) continue;
      const cv::Point pixel(static_cast<int>(at_stop->pixel.x()),
                            static_cast<int>(at_stop->pixel.y()));
      count += hidden.contains(pixel) && track.observations.front().stamp_ns < Stamp(kStop) &&
                       track.observations.back().stamp_ns > Stamp(kStop + kNumStill)
                   ? 1
                   : 0;
    }
    return count;
  };
  const int num_in_view = num_across(TrackStreetWithAStand(kNumStill, SmallOptions()));
  const int num_hidden = num_across(TrackStreetWithAStand(kNumStill, SmallOptions(), hidden));
  ASSERT_GT(num_in_view, 10);
  EXPECT_GT(num_hidden, 0.5 * num_in_view);
  // Were all images kept, they would have been hidden for too many.
  TrackingOptions all = SmallOptions();
  all.buffer.min_motion_px = 0.0;
  EXPECT_LT(num_across(TrackStreetWithAStand(kNumStill, all, hidden)), 0.2 * num_in_view);
}

TEST(CameraTracker, ADriveLosesNoImage) {
  EXPECT_EQ(TrackStreet(Pinhole(), SmallOptions()).num_images_still, 0);
}

TEST(CameraTracker, FindsAndKeepsMoreTracksAtFullResolution) {
  // 400 pixels are within full_size_width_px by default.
  TrackingOptions half = SmallOptions(), full = SmallOptions();
  half.detection.max_features = full.detection.max_features = 20000;
  half.detection.min_distance_px = full.detection.min_distance_px = 1.0;
  half.verification.enough_tracks = full.verification.enough_tracks = 0;
  half.flow.full_size_width_px = 200;
  full.flow.merge_distance_px = 1.5;
  const CameraSegment reduced = TrackStreet(Pinhole(), half);
  const CameraSegment dense = TrackStreet(Pinhole(), full);
  EXPECT_GT(dense.tracks.size(), 2 * reduced.tracks.size());
  std::vector<double> errors_px = TrueErrorsPx(*Pinhole(), dense.tracks);
  std::sort(errors_px.begin(), errors_px.end());
  EXPECT_LT(errors_px[errors_px.size() / 2], 0.2);
}

std::size_t NumObservations(const CameraSegment& segment) {
  std::size_t num_observations = 0;
  for (const Track& track : segment.tracks) num_observations += track.observations.size();
  return num_observations;
}

TEST(CameraTracker, WhereTracksAreFewThoseThatTellLessAreTakenToo) {
  TrackingOptions strict = SmallOptions();
  strict.registration.max_sigma_px = strict.registration.max_misfit_px = 0.025;
  strict.registration.few_tracks_share = 0.0;
  TrackingOptions never_enough = strict;
  never_enough.registration.few_tracks_share = 1.0;
  TrackingOptions lenient = strict;
  lenient.registration.max_sigma_px = lenient.registration.max_misfit_px =
      lenient.registration.max_end_sigma_px = strict.registration.few_tracks_sigma_px;
  const CameraSegment few = TrackStreet(Pinhole(), strict);
  const CameraSegment more = TrackStreet(Pinhole(), never_enough);
  EXPECT_GT(NumObservations(more), 1.2 * NumObservations(few));
  EXPECT_EQ(NumObservations(more), NumObservations(TrackStreet(Pinhole(), lenient)));
  EXPECT_LT(Quantile(TrueErrorsPx(*Pinhole(), more.tracks), 0.95), 0.6);
  strict.registration.few_tracks_share = 0.01;  // 3 an image: there are more
  EXPECT_EQ(NumObservations(TrackStreet(Pinhole(), strict)), NumObservations(few));
}

TEST(CameraTracker, EndsTracksThatRunIntoEachOther) {
  TrackingOptions options = SmallOptions();
  options.flow.merge_distance_px = 30.0;
  const CameraSegment apart = TrackStreet(Pinhole(), options);
  const CameraSegment usual = TrackStreet(Pinhole(), SmallOptions());
  EXPECT_LT(2 * apart.tracks.size(), usual.tracks.size());
}

TEST(CameraTracker, TracksTheSameWhetherImagesAreInMemoryOrInFiles) {
  TrackingOptions options = SmallOptions();
  const CameraSegment in_memory = TrackStreet(Pinhole(), options);
  options.buffer.max_memory_mib = 1;  // about nine of the images
  const CameraSegment in_files = TrackStreet(Pinhole(), options);
  ASSERT_EQ(in_files.images.size(), in_memory.images.size());
  EXPECT_TRUE(in_files.warnings.empty());
  ASSERT_FALSE(in_memory.tracks.empty());
  ASSERT_EQ(in_files.tracks.size(), in_memory.tracks.size());
  for (std::size_t t = 0; t < in_files.tracks.size(); ++t) {
    const auto& observations = in_files.tracks[t].observations;
    ASSERT_EQ(observations.size(), in_memory.tracks[t].observations.size());
    for (std::size_t o = 0; o < observations.size(); ++o) {
      EXPECT_EQ(observations[o].pixel, in_memory.tracks[t].observations[o].pixel);
    }
  }
}

TEST(CameraTracker, ResetForgetsEverything) {
  CameraTracker tracker("cam", Pinhole(), SmallOptions());
  for (int i = 0; i < 4; ++i) {
    ASSERT_TRUE(tracker.AddImage({Stamp(i), StreetImages(Pinhole())[i]}).ok());
  }
  EXPECT_FALSE(tracker.DebugImage().empty());
  tracker.Reset();
  EXPECT_TRUE(tracker.DebugImage().empty());
  EXPECT_TRUE(tracker.Segment().tracks.empty());
  EXPECT_TRUE(tracker.AddImage({Stamp(0), StreetImages(Pinhole())[0]}).ok()) << "time starts anew";
}

TEST(TrackingOptions, DefaultsAreWithinTheirBounds) {
  EXPECT_TRUE(CheckOptions(TrackingOptions()).ok());
}

}  // namespace
}  // namespace scenecalib
