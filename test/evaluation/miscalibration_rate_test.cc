#include "scenecalib/evaluation/miscalibration_rate.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <atomic>
#include <cmath>

#include "rated_drive.h"

namespace scenecalib {
namespace {

class MiscalibrationRates : public RatedDrive {
 protected:
  std::optional<MiscalibrationRate> Rate(const Rig& rig) const {
    const auto rates = ComputeMiscalibrationRates(rig, map_, {&images_}, options_);
    EXPECT_TRUE(rates.ok()) << rates.status().message();
    EXPECT_EQ(rates->size(), 1u);
    return rates->front();
  }
};

TEST_F(MiscalibrationRates, ShowOneCamerasTurnsByItsOwnImages) {
  options_.max_rotation_deg = 1.0;
  options_.max_translation_m = 0.1;
  const auto truth = Rate(rig_);
  ASSERT_TRUE(truth.has_value());
  constexpr double kLow = 0.2;   // grey values are rounded and smoothed: not exactly zero
  constexpr double kHigh = 0.3;  // half of the interval, less what overshoots to the other side
  // A shift that both images of one camera share hardly shows on a nearly straight drive.
  for (const double rate : {truth->roll, truth->pitch, truth->yaw}) EXPECT_LT(rate, kLow);
  const double angle_rad = 0.8 * 3.14159265358979323846 / 180.0;
  const auto pitched = Rate(RigOf({Moved(rig_.cameras[0], {angle_rad, 0.0, 0.0}, {0, 0, 0})}));
  const auto yawed = Rate(RigOf({Moved(rig_.cameras[0], {0.0, angle_rad, 0.0}, {0, 0, 0})}));
  const auto rolled = Rate(RigOf({Moved(rig_.cameras[0], {0.0, 0.0, 2.0 * angle_rad}, {0, 0, 0})}));
  EXPECT_GT(pitched->pitch, kHigh);
  EXPECT_GT(yawed->yaw, kHigh);
  EXPECT_GT(rolled->roll, kHigh);
}

TEST_F(MiscalibrationRates, DoNotDependOnExposure) {
  const auto before = Rate(rig_);
  auto& image = images_.begin()->second;
  image.convertTo(image, -1, 0.5, 20.0);
  const auto after = Rate(rig_);
  ASSERT_TRUE(before && after);
  EXPECT_NEAR(after->pitch, before->pitch, 0.15);  // rounding to half the grey values
  EXPECT_NEAR(after->yaw, before->yaw, 0.15);
}

TEST_F(MiscalibrationRates, CompareCamerasThatSeeTheSame) {
  // Two cameras without a second image each: only the pair across the cameras is left.
  const std::map<Timestamp, cv::Mat> one = {*images_.begin()};
  Rig rig = RigOf({rig_.cameras[0], rig_.cameras[0]});
  const double angle_rad = 0.16 * 3.14159265358979323846 / 180.0;
  rig.cameras[1] = Moved(rig.cameras[1], {0.0, angle_rad, 0.0}, {0, 0, 0});
  const auto rates = ComputeMiscalibrationRates(rig, map_, {&one, &one}, options_);
  ASSERT_TRUE(rates.ok());
  ASSERT_TRUE(rates->at(0) && rates->at(1));
  EXPECT_GT(rates->at(1)->yaw, 0.3);
}

TEST_F(MiscalibrationRates, AnErrorOnOneAxisOfOneCameraShowsOnThatAxisAlone) {
  const std::map<Timestamp, cv::Mat> images = images_;
  Rig rig = RigOf({rig_.cameras[0], rig_.cameras[0]});
  const auto rates_of = [&](const CameraConfig& second) {
    rig.cameras[1] = second;
    const auto rates = ComputeMiscalibrationRates(rig, map_, {&images, &images}, options_);
    EXPECT_TRUE(rates.ok() && rates->at(1));
    const MiscalibrationRate& r = *rates->at(1);
    return std::vector<double>{r.x, r.y, r.z, r.pitch, r.yaw, r.roll};
  };
  const std::vector<double> truth = rates_of(rig_.cameras[0]);
  const double tenth_rad = 0.1 * 3.14159265358979323846 / 180.0;
  for (int axis = 0; axis < 6; ++axis) {
    const Eigen::Vector3d along = Eigen::Vector3d::Unit(axis % 3);
    const std::vector<double> rates =
        rates_of(axis < 3 ? Moved(rig_.cameras[0], {0, 0, 0}, 0.01 * along)
                          : Moved(rig_.cameras[0], tenth_rad * along, {0, 0, 0}));
    for (int other = 0; other < 6; ++other) {
      if (other == axis) {
        EXPECT_GT(rates[other], truth[other] + 0.15) << axis;
      } else {
        EXPECT_LT(rates[other], truth[other] + 0.1) << axis << " shows on " << other;
      }
    }
  }
}

TEST_F(MiscalibrationRates, KnowWhenTheRowsOfARollingShutterAreExposed) {
  const std::map<Timestamp, cv::Mat> at_once = images_;
  rig_.cameras[0].rolling_shutter_line_time_s =
      4e-4;  // 7 cm forward from the first row to the last
  for (auto& [stamp_ns, image] : images_) image = Render(stamp_ns);
  CameraConfig global = rig_.cameras[0];
  global.rolling_shutter_line_time_s.reset();
  const auto worst_of = [&](const CameraConfig& second) {
    const auto rates =
        ComputeMiscalibrationRates(RigOf({global, second}), map_, {&at_once, &images_}, options_);
    EXPECT_TRUE(rates.ok() && rates->at(1));
    const MiscalibrationRate& r = *rates->at(1);
    return std::max({r.x, r.y, r.z, r.pitch, r.yaw, r.roll});
  };
  EXPECT_LT(worst_of(rig_.cameras[0]), 0.15);
  EXPECT_GT(worst_of(global), 0.3);
}

TEST_F(MiscalibrationRates, WithTheOtherAxesFixedATurnLooksLikeAShiftAsInThePaper) {
  Rig rig = RigOf({rig_.cameras[0], Moved(rig_.cameras[0], {0.0, 0.0017, 0.0}, {0, 0, 0})});
  options_.free_other_axes = false;
  const auto fixed = ComputeMiscalibrationRates(rig, map_, {&images_, &images_}, options_);
  options_.free_other_axes = true;
  const auto free = ComputeMiscalibrationRates(rig, map_, {&images_, &images_}, options_);
  ASSERT_TRUE(fixed.ok() && fixed->at(1) && free.ok() && free->at(1));
  EXPECT_GT(fixed->at(1)->x, free->at(1)->x + 0.1);
}

TEST(FieldsOfView, AreThoseOfTheTable) {
  const auto camera = [](double focal_px) {
    return *CreateCameraModel(
        {"ftheta", 960, 600, {}, {479.5, 299.5}, {focal_px, 0.0, 0.0, 0.0, 0.0}, {}});
  };
  EXPECT_EQ(FieldOfViewOf(*camera(1800.0)), FieldOfView::kNarrow);  // 36 degrees across
  EXPECT_EQ(FieldOfViewOf(*camera(685.0)), FieldOfView::kMedium);   // 95
  EXPECT_EQ(FieldOfViewOf(*camera(480.0)), FieldOfView::kMedium);   // 135
  EXPECT_EQ(FieldOfViewOf(*camera(330.0)), FieldOfView::kWide);     // 197
  EXPECT_EQ(PublishedRate(FieldOfView::kWide).x, 0.045);            // Table I, first line of 200
  EXPECT_STREQ(ToString(FieldOfView::kNarrow), "30 deg");
}

TEST_F(MiscalibrationRates, AreTheSameForAnyNumberOfThreads) {
  const auto many = Rate(rig_);
  const tbb::global_control one_thread(tbb::global_control::max_allowed_parallelism, 1);
  const auto one = Rate(rig_);
  ASSERT_TRUE(many && one);
  EXPECT_EQ(many->x, one->x);
  EXPECT_EQ(many->yaw, one->yaw);
  EXPECT_EQ(many->roll, one->roll);
}

TEST_F(MiscalibrationRates, ACameraWithoutPairsHasNone) {
  images_.clear();
  EXPECT_FALSE(Rate(rig_).has_value());
  images_[300000000] = Render(300000000);  // a single image makes no pair
  EXPECT_FALSE(Rate(rig_).has_value());
}

TEST_F(MiscalibrationRates, AMapWithoutSurfacesGivesNone) {
  map_.ground = TriangleMesh();
  EXPECT_FALSE(Rate(rig_).has_value());
}

TEST_F(MiscalibrationRates, AMapWithoutATrajectoryGivesNone) {
  map_.map_from_lidar = Trajectory();
  EXPECT_FALSE(Rate(rig_).has_value());
  const Result<RayCaster> surfaces = RayCaster::Create(map_);
  ASSERT_TRUE(surfaces.ok());
  MiscalibrationRater rater(map_, *surfaces, {&images_}, options_);
  const auto rates = rater.Rate(rig_, false);
  ASSERT_TRUE(rates.ok());
  EXPECT_FALSE(rates->at(0).has_value());
}

TEST_F(MiscalibrationRates, TooFewSharedPointsAreNoEvidence) {
  options_.min_points = 100000;
  EXPECT_FALSE(Rate(rig_).has_value());
}

TEST_F(MiscalibrationRates, AreTheSameWhereRigsBecomeKnownOneAfterTheOther) {
  const Rig moved = RigOf({Moved(rig_.cameras[0], {0.0, 0.01, 0.0}, {0, 0, 0})});
  const Result<RayCaster> surfaces = RayCaster::Create(map_);
  ASSERT_TRUE(surfaces.ok());
  MiscalibrationRater rater(map_, *surfaces, {&images_}, options_);
  const std::atomic<bool> cancelled{false};
  for (const Rig& rig : {moved, rig_}) {
    const auto alone = Rate(rig);
    const auto in_turn = rater.Rate(rig, cancelled);
    ASSERT_TRUE(in_turn.ok() && in_turn->at(0) && alone);
    EXPECT_EQ(in_turn->at(0)->pitch, alone->pitch);
    EXPECT_EQ(in_turn->at(0)->yaw, alone->yaw);
    EXPECT_EQ(in_turn->at(0)->roll, alone->roll);
  }
}

TEST_F(MiscalibrationRates, CanBeCancelled) {
  const Result<RayCaster> surfaces = RayCaster::Create(map_);
  ASSERT_TRUE(surfaces.ok());
  MiscalibrationRater rater(map_, *surfaces, {&images_}, options_);
  std::atomic<bool> cancelled{true};
  EXPECT_EQ(rater.Rate(rig_, cancelled).status().code(), Status::Code::kCancelled);
  cancelled = false;
  EXPECT_TRUE(rater.Rate(rig_, cancelled).ok()) << "a stopped one is not in the way of the next";
}

TEST_F(MiscalibrationRates, RefuseListsOfDifferentLengths) {
  EXPECT_EQ(ComputeMiscalibrationRates(rig_, map_, {}, options_).status().message(),
            "miscalibration rate: images of 0 cameras for a rig of 1");
}

}  // namespace
}  // namespace scenecalib
