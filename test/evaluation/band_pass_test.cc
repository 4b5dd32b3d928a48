#include "../../src/evaluation/band_pass.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

TEST(BandPassImages, AreReadManyPlacesAtOnceAsOneByOne) {
  Random random(1);
  cv::Mat image(60, 80, CV_8UC1);
  image.forEach<unsigned char>([](unsigned char& value, const int* at) {
    value = static_cast<unsigned char>((at[0] * 37 + at[1] * 91 + at[0] * at[1]) % 251);
  });
  const BandPassImage band_pass(image, 0.9);
  std::vector<float> x, y;
  for (int i = 0; i < 150; ++i) {  // two whole batches and a part of one
    x.push_back(static_cast<float>(random.Uniform() * 78.9));
    y.push_back(static_cast<float>(random.Uniform() * 58.9));
  }
  std::vector<float> values(x.size());
  band_pass.At(x.data(), y.data(), x.size(), values.data());
  double spread = 0.0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    EXPECT_NEAR(values[i], band_pass.At(x[i], y[i]), 1e-5) << x[i] << ", " << y[i];
    spread += std::abs(values[i]);
  }
  EXPECT_GT(spread / 150.0, 0.1);
}

TEST(BandPassImages, DependNeitherOnBrightnessNorOnContrast) {
  cv::Mat image(64, 96, CV_8UC1);
  image.forEach<unsigned char>([](unsigned char& value, const int* at) {
    value =
        static_cast<unsigned char>(100.0 + 40.0 * std::sin(0.9 * at[0]) * std::cos(0.7 * at[1]) +
                                   30.0 * std::sin(0.31 * at[1]));
  });
  cv::Mat other;
  image.convertTo(other, -1, 0.7, 50.0);
  const BandPassImage a(image, 0.9);
  const BandPassImage b(other, 0.9);
  for (int row = 8; row < 56; row += 5) {
    for (int column = 8; column < 88; column += 7) {
      EXPECT_NEAR(a.At(column, row), b.At(column, row), 0.12) << column << ", " << row;
    }
  }
}

}  // namespace
}  // namespace scenecalib
