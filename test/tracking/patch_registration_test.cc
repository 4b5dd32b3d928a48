#include "scenecalib/tracking/patch_registration.h"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include "scenecalib/tracking/pixel_reading.h"
#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

using testing::Render;
using testing::Texture;

constexpr int kSize = 96;
/// Rounding to whole grey values alone leaves a few thousandths of a pixel.
constexpr double kExactPx = 0.01;

const Texture& Wall() {
  static const Texture texture(3, 8.0, 40.0);
  return texture;
}

cv::Mat Reference(double noise = 0.0, std::uint64_t seed = 1) {
  return Render(kSize, kSize, Wall(), noise, seed);
}

/// The reference seen through a warp: its pixel q shows what the reference shows at warp^-1(q).
cv::Mat Warped(const Eigen::Vector2d& reference_px, const PatchWarp& warp, double gain, double bias,
               double noise = 0.0, std::uint64_t seed = 2) {
  const Eigen::Matrix2d inverse = warp.affine.inverse();
  return Render(
      kSize, kSize,
      [&](double x, double y) {
        Eigen::Vector2d offset = inverse * (Eigen::Vector2d(x, y) - warp.center_px);
        for (int i = 0; i < 20; ++i) {  // fixed point of the second-order term
          const Eigen::Vector2d bent = warp(offset) - warp.center_px - warp.affine * offset;
          offset = inverse * (Eigen::Vector2d(x, y) - warp.center_px - bent);
        }
        return gain * Wall()(reference_px.x() + offset.x(), reference_px.y() + offset.y()) + bias;
      },
      noise, seed);
}

TEST(ReadSmoothed, GradientIsTheDerivativeOfTheValue) {
  const cv::Mat image = Reference();
  constexpr double kStep = 0.01;
  for (double t = 0.03; t < 1.0; t += 0.19) {
    const double x = 40.0 + t;
    const double y = 50.0 + 0.7 * t;
    const SmoothedPixel pixel = ReadSmoothed(image, x, y);
    const double dx =
        (ReadSmoothed(image, x + kStep, y).value - ReadSmoothed(image, x - kStep, y).value);
    const double dy =
        (ReadSmoothed(image, x, y + kStep).value - ReadSmoothed(image, x, y - kStep).value);
    EXPECT_NEAR(pixel.gradient_x, dx / (2 * kStep), 0.02);
    EXPECT_NEAR(pixel.gradient_y, dy / (2 * kStep), 0.02);
  }
}

TEST(PatchTemplate, RecoversShiftsAtEverySubpixelPhaseWithoutPullToTheGrid) {
  const Eigen::Vector2d reference_px(48, 48);
  const auto patch =
      PatchTemplate::Create(Reference(), reference_px, 10, WarpFreedom::kAffine).value();
  for (double phase = 0.0; phase < 1.0; phase += 0.125) {
    PatchWarp truth;
    truth.center_px = reference_px + Eigen::Vector2d(phase, 1.0 - 0.6 * phase);
    PatchWarp initial;
    initial.center_px = reference_px;
    const auto match = patch.Register(Warped(reference_px, truth, 1.0, 0.0), initial, {});
    ASSERT_TRUE(match) << "phase " << phase;
    EXPECT_LT((match->warp.center_px - truth.center_px).norm(), kExactPx) << "phase " << phase;
    EXPECT_GT(match->ncc, 0.995);
  }
}

TEST(PatchTemplate, RecoversAffineWarpGainAndBias) {
  const Eigen::Vector2d reference_px(48, 48);
  const auto patch =
      PatchTemplate::Create(Reference(), reference_px, 10, WarpFreedom::kAffine).value();
  PatchWarp truth;
  truth.center_px = {50.3, 46.8};
  truth.affine << 1.2, 0.1, -0.15, 0.9;
  PatchWarp initial;
  initial.center_px = {49.5, 47.5};
  const auto match = patch.Register(Warped(reference_px, truth, 0.6, 30.0), initial, {});
  ASSERT_TRUE(match);
  EXPECT_LT((match->warp.center_px - truth.center_px).norm(), 0.02);
  EXPECT_LT((match->warp.affine - truth.affine).norm(), 0.02);
  EXPECT_NEAR(match->gain, 0.6, 0.02);
}

TEST(PatchTemplate, ShiftAloneUsesTheWholeSecondOrderWarp) {
  const Eigen::Vector2d reference_px(48, 48);
  const auto shift =
      PatchTemplate::Create(Reference(), reference_px, 10, WarpFreedom::kShift).value();
  PatchWarp truth;
  truth.center_px = {49.37, 47.81};
  truth.affine << 1.3, 0.1, 0.0, 1.1;
  truth.quadratic << 0.006, 0.002, -0.004, -0.003, 0.005, 0.007;
  PatchWarp initial = truth;
  initial.center_px = {50.0, 47.0};
  const cv::Mat other = Warped(reference_px, truth, 1.1, -5.0);
  const auto with = shift.Register(other, initial, {});
  ASSERT_TRUE(with);
  // Where the warp stretches, two readings stand for the blur of the reference.
  EXPECT_LT((with->warp.center_px - truth.center_px).norm(), 1.5 * kExactPx);
  initial.quadratic.setZero();
  const auto without = shift.Register(other, initial, {});
  ASSERT_TRUE(without);
  EXPECT_GT((without->warp.center_px - truth.center_px).norm(),
            3.0 * (with->warp.center_px - truth.center_px).norm());
}

TEST(PatchTemplate, CovarianceAgreesWithTheScatterUnderNoise) {
  const Eigen::Vector2d reference_px(48, 48);
  PatchWarp truth;
  truth.center_px = {48.4, 47.7};
  double normalised = 0.0;
  constexpr int kTrials = 60;
  for (int trial = 0; trial < kTrials; ++trial) {
    const cv::Mat reference = Reference(4.0, 100 + trial);
    const cv::Mat other = Warped(reference_px, truth, 1.0, 0.0, 4.0, 500 + trial);
    const auto patch =
        PatchTemplate::Create(reference, reference_px, 10, WarpFreedom::kAffine).value();
    const auto match = patch.Register(other, truth, {});
    ASSERT_TRUE(match);
    const Eigen::Vector2d error = match->warp.center_px - truth.center_px;
    EXPECT_LT(error.norm(), 0.25);
    normalised += error.dot(match->covariance_px2.inverse() * error) / 2.0;
  }
  // The spline's smoothing correlates neighbours: up to 4 times the independent covariance.
  EXPECT_GT(normalised / kTrials, 1.0);
  EXPECT_LT(normalised / kTrials, 5.0);
}

TEST(PatchTemplate, RefusesFlatPatchesEdgesAndTheImageBorder) {
  const cv::Mat flat(kSize, kSize, CV_8UC1, cv::Scalar(77));
  EXPECT_FALSE(PatchTemplate::Create(flat, {48, 48}, 10, WarpFreedom::kAffine));
  const cv::Mat edge = Render(kSize, kSize, [](double x, double) { return x < 48 ? 40.0 : 200.0; });
  EXPECT_FALSE(PatchTemplate::Create(edge, {48, 48}, 10, WarpFreedom::kShift));
  EXPECT_FALSE(PatchTemplate::Create(Reference(), {10, 48}, 10, WarpFreedom::kAffine));
  EXPECT_TRUE(PatchTemplate::Create(Reference(), {12, 48}, 10, WarpFreedom::kAffine));
}

TEST(PatchTemplate, RefusesMatchesThatMoveTooFarOrLeaveTheImage) {
  const Eigen::Vector2d reference_px(48, 48);
  const auto patch =
      PatchTemplate::Create(Reference(), reference_px, 10, WarpFreedom::kShift).value();
  PatchWarp truth;
  truth.center_px = {51.0, 48.0};
  PatchWarp initial;
  initial.center_px = reference_px;
  PatchRegistrationLimits limits;
  limits.max_correction_px = 2.0;
  const cv::Mat other = Warped(reference_px, truth, 1.0, 0.0);
  EXPECT_FALSE(patch.Register(other, initial, limits));
  limits.max_correction_px = 4.0;
  EXPECT_TRUE(patch.Register(other, initial, limits));
  initial.center_px = {6.0, 48.0};
  EXPECT_FALSE(patch.Register(other, initial, limits));
}

/// The wall as a camera sees it: every pixel the mean over its area, as many wall units wide as
/// `scale` is small.
cv::Mat Photograph(double scale, std::uint64_t seed) {
  static const Texture fine(9, 3.0, 20.0);
  constexpr int kSubpixels = 5;
  return Render(
      kSize, kSize,
      [&](double x, double y) {
        double sum = 0.0;
        for (int i = 0; i < kSubpixels; ++i) {
          for (int j = 0; j < kSubpixels; ++j) {
            const double u = x + (i + 0.5) / kSubpixels - 0.5;
            const double v = y + (j + 0.5) / kSubpixels - 0.5;
            sum += fine((u - 48.0) / scale, (v - 48.0) / scale);
          }
        }
        return sum / (kSubpixels * kSubpixels);
      },
      1.0, seed);
}

/// How alike the views of two scales are once registered, from the first to the second.
double ResidualBetween(double first_scale, double second_scale, bool sharp_reference) {
  const cv::Mat first = Photograph(first_scale, 1);
  const cv::Mat second = Photograph(second_scale, 2);
  PatchWarp initial;
  initial.center_px = {48.2, 47.9};
  initial.affine *= second_scale / first_scale;
  std::optional<PatchMatch> match;
  if (sharp_reference) {
    match = PatchTemplate::Create(first, {48, 48}, 10, WarpFreedom::kAffine)
                .value()
                .Register(second, initial, {});
  } else {
    match = ReferencePatch::Create(first, {48, 48}, 10, WarpFreedom::kAffine)
                .value()
                .Register(second, initial, {});
  }
  if (!match) return 1e3;
  EXPECT_LT((match->warp.center_px - Eigen::Vector2d(48, 48)).norm(), 0.05);
  return match->residual_sigma / match->gain;
}

TEST(ReferencePatch, IsBlurredForAViewFromAfar) {
  EXPECT_LT(ResidualBetween(2.0, 1.0, false), 0.6 * ResidualBetween(2.0, 1.0, true));
}

TEST(ReferencePatch, IsTheSharpTemplateForViewsOfItsOwnScale) {
  EXPECT_EQ(ResidualBetween(1.0, 1.0, false), ResidualBetween(1.0, 1.0, true));
}

TEST(ReferencePatch, FallsBackToTheSharpViewAtTheImageBorder) {
  const cv::Mat first = Photograph(2.0, 1);
  auto patch = ReferencePatch::Create(first, {12, 48}, 10, WarpFreedom::kAffine);
  ASSERT_TRUE(patch);
  PatchWarp initial;
  initial.center_px = {30, 48};
  initial.affine *= 0.5;
  EXPECT_TRUE(patch->Register(Photograph(1.0, 2), initial, {}));
  EXPECT_FALSE(ReferencePatch::Create(first, {10, 48}, 10, WarpFreedom::kAffine));
}

}  // namespace
}  // namespace scenecalib
