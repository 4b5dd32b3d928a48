#include "../../src/evaluation/image_pairs.h"

#include "rated_drive.h"

namespace scenecalib {
namespace {

class ImagePairsOf : public RatedDrive {
 protected:
  ImagePairs Collect(const Rig& rig) {
    const Result<RayCaster> caster = RayCaster::Create(map_);
    EXPECT_TRUE(caster.ok());
    band_pass_.clear();
    return CollectImagePairs(
        rig, map_, *caster,
        std::vector<const std::map<Timestamp, cv::Mat>*>(rig.cameras.size(), &images_), options_,
        false, &band_pass_);
  }
  BandPassImages band_pass_;
};

TEST_F(ImagePairsOf, CamerasThatSeeTheSameAreOfTwoCamerasEach) {
  const ImagePairs pairs = Collect(RigOf({rig_.cameras[0], rig_.cameras[0]}));
  ASSERT_EQ(pairs.pairs_of_camera.size(), 2u);
  EXPECT_EQ(pairs.pairs_of_camera[0].size(), 2u);  // images are near two of the four times
  EXPECT_EQ(pairs.pairs_of_camera[1].size(), 2u);
  for (const Comparison& comparison : pairs.comparisons) {
    EXPECT_FALSE(comparison.same_camera);
    EXPECT_EQ(comparison.pixels.size(), comparison.other_values.size());
    EXPECT_TRUE(comparison.other_pixels_by_pose.empty());
  }
}

TEST_F(ImagePairsOf, ACameraAloneAreOfItselfLater) {
  const ImagePairs pairs = Collect(rig_);
  ASSERT_FALSE(pairs.comparisons.empty());
  for (const Comparison& comparison : pairs.comparisons) {
    EXPECT_TRUE(comparison.same_camera);
    EXPECT_EQ(comparison.pixels.size(), comparison.other_pixels_by_pose.size());
    EXPECT_NE(comparison.image, comparison.other_image);
  }
}

TEST_F(ImagePairsOf, ManyOrLargeCamerasAreOfFewerTimesForTheirMemory) {
  CameraConfig camera = rig_.cameras[0];
  options_.num_times = 40;
  const auto times_of = [&](int width_px, int height_px, std::size_t num_cameras) {
    camera.model = *CreateCameraModel(
        {"ftheta", width_px, height_px, {}, {100.0, 100.0}, {500.0, 0.0, 0.0, 0.0, 0.0}, {}});
    return NumTimes(RigOf(std::vector<CameraConfig>(num_cameras, camera)), options_);
  };
  EXPECT_EQ(times_of(960, 604, 8), 40);
  EXPECT_EQ(times_of(960, 604, 12), 28);   // 28 times 14 million pixels
  EXPECT_EQ(times_of(3848, 2168, 4), 20);  // no fewer
  options_.num_times = 5;
  EXPECT_EQ(times_of(3848, 2168, 4), 5) << "as asked for";
}

TEST_F(ImagePairsOf, TwoEqualCamerasShowTheSamePixelsOfEveryPoint) {
  const ImagePairs pairs = Collect(RigOf({rig_.cameras[0], rig_.cameras[0]}));
  for (const Comparison& comparison : pairs.comparisons) {
    for (std::size_t i = 0; i < comparison.pixels.size(); ++i) {
      EXPECT_EQ(comparison.pixels[i], comparison.other_pixels[i]);
    }
  }
}

TEST_F(ImagePairsOf, AMovedCameraShowsItsPointsWhereTheDerivativesSay) {
  constexpr double kScaled = 0.1;  // of the range of 0.2 degrees: second order is below 0.001 px
  constexpr float kTolerancePx = 0.01F;
  const double angle_rad = kScaled * options_.max_rotation_deg * 3.14159265358979323846 / 180.0;
  options_.max_points = 100000;
  const Rig rig = RigOf({rig_.cameras[0], rig_.cameras[0]});
  const ImagePairs before = Collect(rig);
  const Comparison& judged = before.comparisons[before.pairs_of_camera[0].front()];
  const Eigen::Matrix<float, kNumAxes, 1> yaw =
      static_cast<float>(kScaled) * Eigen::Matrix<float, kNumAxes, 1>::Unit(4);
  const Eigen::Quaterniond camera_from_moved(ExpSo3({0.0, angle_rad, 0.0}));
  const CameraModel& model = *rig.cameras[0].model;
  ASSERT_GT(judged.pixels.size(), 100u);
  for (std::size_t i = 0; i < judged.pixels.size(); i += 17) {
    const auto ray = model.Unproject(judged.pixels[i].cast<double>());
    ASSERT_TRUE(ray.has_value());
    const auto pixel = model.Project(camera_from_moved.conjugate() * *ray);
    ASSERT_TRUE(pixel.has_value());
    const Eigen::Vector2f predicted = judged.pixels[i] + judged.pixels_by_pose[i] * yaw;
    EXPECT_LT((predicted - pixel->cast<float>()).norm(), kTolerancePx);
  }
}

TEST_F(ImagePairsOf, TooFewSharedPointsAreLeftOut) {
  options_.min_points = 100000;
  const ImagePairs pairs = Collect(RigOf({rig_.cameras[0], rig_.cameras[0]}));
  EXPECT_TRUE(pairs.comparisons.empty());
  EXPECT_TRUE(pairs.pairs_of_camera[0].empty());
}

TEST_F(ImagePairsOf, ImagesOfAnotherSizeThanTheRigSaysAreNotUsed) {
  for (auto& [stamp_ns, image] : images_) image = cv::Mat(20, 30, CV_8UC1, cv::Scalar(0));
  EXPECT_TRUE(Collect(rig_).comparisons.empty());
}

}  // namespace
}  // namespace scenecalib
