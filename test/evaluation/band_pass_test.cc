#include "../../src/evaluation/band_pass.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
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

/// Of rows and columns whose borders are repeated.
class Image {
 public:
  Image(int columns, int rows)
      : columns_(columns), rows_(rows), values_(static_cast<std::size_t>(columns) * rows) {}

  double& At(int column, int row) {
    return values_[static_cast<std::size_t>(std::clamp(row, 0, rows_ - 1)) * columns_ +
                   std::clamp(column, 0, columns_ - 1)];
  }
  /// Every value a weighted sum over a square, the weights being the products of `weights`.
  Image Weighed(const std::vector<double>& weights) {
    const int radius = static_cast<int>(weights.size() / 2);
    Image sums(columns_, rows_);
    for (int row = 0; row < rows_; ++row) {
      for (int column = 0; column < columns_; ++column) {
        for (int dy = -radius; dy <= radius; ++dy) {
          for (int dx = -radius; dx <= radius; ++dx) {
            sums.At(column, row) +=
                weights[dy + radius] * weights[dx + radius] * At(column + dx, row + dy);
          }
        }
      }
    }
    return sums;
  }

 private:
  int columns_, rows_;
  std::vector<double> values_;
};

TEST(BandPassImages, AreDifferencesOfWeighedSumsOverTheirContrast) {
  constexpr int kColumns = 83;  // no multiple of anything
  constexpr int kRows = 45;
  Random random(2);
  cv::Mat pixels(kRows, kColumns, CV_8UC1);
  Image grey(kColumns, kRows);
  for (int row = 0; row < kRows; ++row) {
    for (int column = 0; column < kColumns; ++column) {
      // Black beside white: what running sums carry along would show in the black part.
      const double value = column < 50 ? 255.0 * random.Uniform() : 3.0 * random.Uniform();
      pixels.at<unsigned char>(row, column) = static_cast<unsigned char>(value);
      grey.At(column, row) = pixels.at<unsigned char>(row, column);
    }
  }
  const double sigma_px = 0.9;
  std::vector<double> gaussian;
  for (int k = -3; k <= 3; ++k) gaussian.push_back(std::exp(-0.5 * k * k / (sigma_px * sigma_px)));
  const double sum = std::accumulate(gaussian.begin(), gaussian.end(), 0.0);
  for (double& weight : gaussian) weight /= sum;
  const std::vector<double> box(19, 1.0 / 19.0);  // of eight times the deviation, twice
  Image detail = grey.Weighed(gaussian);
  Image wide = detail.Weighed(box).Weighed(box);
  Image square(kColumns, kRows);
  for (int row = 0; row < kRows; ++row) {
    for (int column = 0; column < kColumns; ++column) {
      detail.At(column, row) -= wide.At(column, row);
      square.At(column, row) = detail.At(column, row) * detail.At(column, row);
    }
  }
  Image variance = square.Weighed(box).Weighed(box);
  const BandPassImage band_pass(pixels, sigma_px);
  for (int row = 0; row + 1 < kRows; ++row) {
    for (int column = 0; column + 1 < kColumns; ++column) {
      const double expected = detail.At(column, row) / std::sqrt(variance.At(column, row) + 9.0);
      EXPECT_NEAR(band_pass.At(column, row), expected, 2e-3) << column << ", " << row;
    }
  }
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
