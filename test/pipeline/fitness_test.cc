#include "scenecalib/pipeline/fitness.h"

#include <gtest/gtest.h>

#include "scenecalib/base/random.h"
#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

constexpr int kColumns = 320;
constexpr int kRows = 200;

/// A textured wall that drifts by 3 px an image: patches of random brightness with soft edges.
cv::Mat Daylight(int index) {
  cv::Mat image(kRows, kColumns, CV_8UC1);
  for (int y = 0; y < kRows; ++y) {
    for (int x = 0; x < kColumns; ++x) {
      const int at = x + 3 * index;
      const auto brightness = [](int column, int row) {
        return Random(static_cast<std::uint64_t>(column * 7919 + row)).Uniform(30.0, 220.0);
      };
      const double u = at / 12.0;
      const double v = y / 12.0;
      const int c = static_cast<int>(u);
      const int r = static_cast<int>(v);
      const double fx = u - c;
      const double fy = v - r;
      const double value = (1 - fy) * ((1 - fx) * brightness(c, r) + fx * brightness(c + 1, r)) +
                           fy * ((1 - fx) * brightness(c, r + 1) + fx * brightness(c + 1, r + 1));
      image.at<unsigned char>(y, x) = static_cast<unsigned char>(value);
    }
  }
  return image;
}

void AddNoise(double levels, Random* random, cv::Mat* image) {
  for (int i = 0; i < image->rows * image->cols; ++i) {
    const double value = image->data[i] + levels * random->Gaussian();
    image->data[i] = static_cast<unsigned char>(std::min(255.0, std::max(0.0, value)));
  }
}

/// What the tracker makes of twelve images, through to the verdict.
template <typename MakeImage>
std::string Verdict(const MakeImage& make_image) {
  const CameraModelPtr model = *CreateCameraModel(
      {"ftheta", kColumns, kRows, {}, {159.5, 99.5}, {250.0, 0.0, 0.0, 0.0, 0.0}, {}});
  CameraTracker tracker("front", model, TrackingOptions());
  Random random(7);
  for (int i = 0; i < 12; ++i) {
    EXPECT_TRUE(tracker.AddImage({i * 100000000LL, make_image(i, &random)}).ok());
  }
  return WhyUnfit(MeasureFitness(tracker.Segment()), FitnessOptions());
}

TEST(Fitness, DaylightIsFit) {
  EXPECT_EQ(Verdict([](int i, Random* random) {
              cv::Mat image = Daylight(i);
              AddNoise(1.5, random, &image);
              return image;
            }),
            "");
}

TEST(Fitness, NightIsTooDark) {
  const std::string reason = Verdict([](int i, Random* random) {
    cv::Mat image = Daylight(i);
    image.convertTo(image, -1, 1.0 / 32.0);  // five stops
    AddNoise(3.0, random, &image);
    return image;
  });
  EXPECT_EQ(reason.substr(0, 8), "too dark") << reason;
  EXPECT_NE(reason.find("limit 18.0"), std::string::npos) << reason;
}

TEST(Fitness, RainIsNotFitBecauseItsFeaturesDoNotStay) {
  const std::string reason = Verdict([](int i, Random* random) {
    cv::Mat image = Daylight(i);
    image.convertTo(image, -1, 0.3, 80.0);  // grey veil
    for (int k = 0; k < 1500; ++k) {        // streaks elsewhere in every image
      const int x = static_cast<int>(random->Index(kColumns));
      const int y = static_cast<int>(random->Index(kRows - 12));
      for (int dy = 0; dy < 12; ++dy) image.at<unsigned char>(y + dy, x) = 230;
    }
    return image;
  });
  EXPECT_NE(reason.find("rain"), std::string::npos) << reason;
}

TEST(Fitness, SkyAloneHasNoFeatures) {
  const std::string reason = Verdict([](int, Random* random) {
    cv::Mat image(kRows, kColumns, CV_8UC1);
    for (int y = 0; y < kRows; ++y) image.row(y).setTo(200 - y / 3);
    AddNoise(1.0, random, &image);
    return image;
  });
  EXPECT_NE(reason.find("sky"), std::string::npos) << reason;
}

TEST(Fitness, ACameraWithoutImagesIsLeftToTheCheckOfItsStream) {
  EXPECT_EQ(MeasureFitness(CameraSegment()).tracks_per_image, 0.0);
}

TEST(Fitness, AThickOrShortMapIsRefusedWithMeasureAndLimit) {
  MappingReport report;
  report.path_length_m = 50.0;
  report.thickness_after_m = 0.015;
  EXPECT_TRUE(CheckMapFitness(report, FitnessOptions()).ok());
  report.thickness_after_m = 0.2;
  const Status thick = CheckMapFitness(report, FitnessOptions());
  EXPECT_EQ(thick.code(), Status::Code::kInsufficientData);
  EXPECT_NE(thick.message().find("0.200 m thick, limit 0.080 m"), std::string::npos);
  report.thickness_after_m = 0.015;
  report.path_length_m = 0.1;
  EXPECT_NE(CheckMapFitness(report, FitnessOptions()).message().find("did not move"),
            std::string::npos);
}

TEST(Fitness, ReturnsThatHangInTheAirAreNamedAsSnow) {
  MappingReport report;
  report.path_length_m = 50.0;
  report.thickness_after_m = 0.2;  // the map of it is bad as well
  report.airborne_share = 0.16;
  const Status status = CheckMapFitness(report, FitnessOptions());
  EXPECT_EQ(status.code(), Status::Code::kInsufficientData);
  EXPECT_NE(status.message().find("16 %"), std::string::npos);
  EXPECT_NE(status.message().find("limit 10 %: snow"), std::string::npos);
  report.thickness_after_m = 0.015;
  report.airborne_share = 0.01;
  EXPECT_TRUE(CheckMapFitness(report, FitnessOptions()).ok());
}

}  // namespace
}  // namespace scenecalib
