#include "scenecalib/evaluation/miscalibration_rate.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>

#include "evaluation_fixture.h"

namespace scenecalib {
namespace {

/// A drive along x between a wall on the left, ground below and a wall ahead, all with a texture.
class MiscalibrationRates : public ::testing::Test {
 protected:
  void SetUp() override {
    std::vector<TimedPose> poses;
    for (int i = 0; i <= 20; ++i) {
      poses.push_back({i * 100000000LL, Rigid3(ExpSo3({0.0, 0.0, 0.01 * i}), {0.3 * i, 0.0, 0.0})});
    }
    map_.map_from_lidar = Trajectory::Create(poses).value();
    AddQuad({-1.0, 4.0, -1.7}, {21.0, 0.0, 0.0}, {0.0, 0.0, 9.0});    // left
    AddQuad({-1.0, -6.0, -1.7}, {21.0, 0.0, 0.0}, {0.0, 10.0, 0.0});  // ground
    AddQuad({20.0, -6.0, -1.7}, {0.0, 10.0, 0.0}, {0.0, 0.0, 9.0});   // ahead
    rig_ = RigOf({ForwardCamera("front")});
    rig_.cameras[0].model = *CreateCameraModel(
        {"ftheta", 240, 180, {}, {119.5, 89.5}, {150.0, 0.0, 0.0, 0.0, 0.0}, {}});
    for (const Timestamp stamp_ns : {300000000LL, 800000000LL, 1100000000LL, 1600000000LL}) {
      images_[stamp_ns] = Render(stamp_ns);
    }
    options_.num_times = 4;
    options_.num_samples = 30;
    options_.max_points = 3000;  // of four times where a recording has twenty
  }

  void AddQuad(const Eigen::Vector3d& corner_m, const Eigen::Vector3d& u,
               const Eigen::Vector3d& v) {
    TriangleMesh& mesh = map_.ground;
    const int first = static_cast<int>(mesh.vertices_m.size());
    for (const Eigen::Vector3d& at :
         {corner_m, Eigen::Vector3d(corner_m + u), Eigen::Vector3d(corner_m + u + v),
          Eigen::Vector3d(corner_m + v)}) {
      mesh.vertices_m.push_back(at.cast<float>());
    }
    mesh.triangles.push_back({first, first + 1, first + 2});
    mesh.triangles.push_back({first, first + 2, first + 3});
  }

  static double Texture(const Eigen::Vector3d& p) {
    // Patterns of a metre and of a third of that: the latter are some 10 px wide.
    return 128.0 + 30.0 * std::sin(6.1 * p.x() + 5.3 * p.y() * p.z()) +
           40.0 * std::sin(14.7 * p.z() - 12.9 * p.x()) * std::cos(13.9 * p.y());
  }

  /// Exact: the first of the three planes that a pixel's ray meets.
  cv::Mat Render(Timestamp stamp_ns) const {
    const CameraConfig& camera = rig_.cameras[0];
    const Rigid3 map_from_camera =
        *map_.map_from_lidar.Interpolate(stamp_ns) * camera.lidar_from_camera;
    cv::Mat image(camera.model->height_px(), camera.model->width_px(), CV_8UC1, cv::Scalar(0));
    for (int y = 0; y < image.rows; ++y) {
      for (int x = 0; x < image.cols; ++x) {
        const Eigen::Vector3d& origin = map_from_camera.translation;
        const Eigen::Vector3d ray =
            map_from_camera.rotation * *camera.model->Unproject(Eigen::Vector2d(x, y));
        const double ranges_m[] = {(20.0 - origin.x()) / ray.x(), (4.0 - origin.y()) / ray.y(),
                                   (-1.7 - origin.z()) / ray.z()};
        double nearest_m = 1e3;
        for (const double range_m : ranges_m) {
          if (range_m > 0.0) nearest_m = std::min(nearest_m, range_m);
        }
        image.at<unsigned char>(y, x) =
            static_cast<unsigned char>(std::lround(Texture(origin + nearest_m * ray)));
      }
    }
    return image;
  }

  std::optional<MiscalibrationRate> Rate(const Rig& rig) const {
    const auto rates = ComputeMiscalibrationRates(rig, map_, {&images_}, options_);
    EXPECT_TRUE(rates.ok()) << rates.status().message();
    EXPECT_EQ(rates->size(), 1u);
    return rates->front();
  }

  SceneMap map_;
  Rig rig_;
  std::map<Timestamp, cv::Mat> images_;
  MiscalibrationOptions options_;
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

TEST_F(MiscalibrationRates, TooFewSharedPointsAreNoEvidence) {
  options_.min_points = 100000;
  EXPECT_FALSE(Rate(rig_).has_value());
}

TEST_F(MiscalibrationRates, RefuseListsOfDifferentLengths) {
  EXPECT_EQ(ComputeMiscalibrationRates(rig_, map_, {}, options_).status().message(),
            "miscalibration rate: images of 0 cameras for a rig of 1");
}

}  // namespace
}  // namespace scenecalib
