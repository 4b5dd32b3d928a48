#include "scenecalib/tracking/reference_registration.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tracking/synthetic_scene.h"

namespace scenecalib {
namespace {

using testing::Render;
using testing::Texture;

constexpr Timestamp kFirst = 1'000;
constexpr Timestamp kSecond = 2'000;
constexpr int kEdgePx = 100;
constexpr double kParallaxPx = 2.5;

/// A near thing on the left of an edge stays, what lies behind it moves by the parallax.
std::map<Timestamp, cv::Mat> TwoDepths() {
  const Texture near(1, 7.0, 40.0);
  const Texture far(2, 7.0, 40.0);
  const auto at = [&](double shift_px) {
    return [&near, &far, shift_px](double x, double y) {
      return x < kEdgePx ? near(x, y) : far(x - shift_px, y);
    };
  };
  return {{kFirst, Render(200, 120, at(0.0), 1.0, 1)},
          {kSecond, Render(200, 120, at(kParallaxPx), 1.0, 2)}};
}

class ReferenceMatcherTest : public ::testing::Test {
 protected:
  /// The match of a patch around `center_px`, searched where the near side is.
  std::optional<PatchMatch> MatchAt(const Eigen::Vector2d& center_px, bool* parts_disagree) const {
    const ReferenceMatcher matcher(images_, mask_, quality_, options_);
    auto view = matcher.Prepare(kFirst, center_px);
    if (!view) return std::nullopt;
    PatchWarp initial;
    initial.center_px = center_px;
    const auto match = matcher.MatchWhole(&*view, initial, kSecond);
    *parts_disagree = match && matcher.PartsDisagree(&*view, match->warp, kSecond);
    return match;
  }

  std::map<Timestamp, cv::Mat> images_ = TwoDepths();
  cv::Mat mask_ = cv::Mat(120, 200, CV_8UC1, cv::Scalar(255));
  ImageQuality quality_ = MeasureImageQuality(images_.at(kFirst), mask_);
  RegistrationOptions options_;
};

TEST_F(ReferenceMatcherTest, FollowsEitherSideOfADepthEdge) {
  bool parts_disagree = true;
  const auto near = MatchAt({60, 60}, &parts_disagree);
  ASSERT_TRUE(near);
  EXPECT_FALSE(parts_disagree);
  EXPECT_LT((near->warp.center_px - Eigen::Vector2d(60, 60)).norm(), 0.05);
  const auto far = MatchAt({140, 60}, &parts_disagree);
  ASSERT_TRUE(far);
  EXPECT_FALSE(parts_disagree);
  EXPECT_LT((far->warp.center_px - Eigen::Vector2d(140 + kParallaxPx, 60)).norm(), 0.05);
}

TEST_F(ReferenceMatcherTest, RefusesAPatchAcrossTheEdge) {
  for (int y = 20; y <= 100; y += 8) {
    for (const int x : {kEdgePx - 4, kEdgePx, kEdgePx + 4}) {
      bool parts_disagree = false;
      const auto match = MatchAt(Eigen::Vector2d(x, y), &parts_disagree);
      EXPECT_TRUE(!match || parts_disagree) << x << ", " << y;
    }
  }
}

TEST_F(ReferenceMatcherTest, TheResidualAloneGivesMostEdgesAway) {
  int num_refused = 0;
  for (int y = 20; y <= 100; y += 4) {
    bool parts_disagree = false;
    num_refused += MatchAt(Eigen::Vector2d(kEdgePx, y), &parts_disagree) ? 0 : 1;
  }
  EXPECT_GE(num_refused, 19) << "of 21";
}

TEST_F(ReferenceMatcherTest, TheCoreMatchesBesideTheEdge) {
  constexpr int kBesidePx = 8;  // the whole patch reaches over the edge, its core does not
  const ReferenceMatcher matcher(images_, mask_, quality_, options_);
  int num_matched = 0;
  for (int y = 20; y <= 100; y += 4) {
    auto view = matcher.Prepare(kFirst, Eigen::Vector2d(kEdgePx - kBesidePx, y));
    ASSERT_TRUE(view);
    PatchWarp initial;
    initial.center_px = view->center_px;
    const auto found = matcher.Match(&*view, initial, kSecond);
    if (!found) continue;
    ++num_matched;
    EXPECT_LT((found->match.warp.center_px - view->center_px).norm(), 0.15) << y;
  }
  EXPECT_GE(num_matched, 11) << "of 21";
}

TEST_F(ReferenceMatcherTest, NeitherWholeNorCoreMatchesOnTheEdge) {
  const ReferenceMatcher matcher(images_, mask_, quality_, options_);
  int num_matched = 0;
  for (int y = 20; y <= 100; y += 4) {
    auto view = matcher.Prepare(kFirst, Eigen::Vector2d(kEdgePx, y));
    if (!view) continue;
    PatchWarp initial;
    initial.center_px = view->center_px;
    num_matched += matcher.Match(&*view, initial, kSecond) ? 1 : 0;
  }
  EXPECT_LE(num_matched, 1) << "of 21";
}

/// Something in relief at the centre of every patch: it moves by more than what surrounds it.
class ReliefTest : public ReferenceMatcherTest {
 protected:
  static constexpr int kRadiusPx = 5;
  static constexpr int kPeriodPx = 40;

  static std::map<Timestamp, cv::Mat> Walls(double relief_px) {
    const Texture wall(3, 7.0, 40.0);
    const auto at = [&](double shift_px) {
      return [&wall, shift_px](double x, double y) {
        const double from_x = std::remainder(x - 20.0, kPeriodPx);
        const double from_y = std::remainder(y - 20.0, kPeriodPx);
        const bool is_relief = std::hypot(from_x, from_y) < kRadiusPx;
        return wall(is_relief ? x - shift_px : x, y);
      };
    };
    return {{kFirst, Render(200, 120, at(0.0), 1.0, 1)},
            {kSecond, Render(200, 120, at(relief_px), 1.0, 2)}};
  }

  /// Of the 15 patches with something in relief at their centre.
  int NumRefused(double relief_px) {
    images_ = Walls(relief_px);
    int num_refused = 0;
    for (int y = 20; y <= 100; y += kPeriodPx) {
      for (int x = 20; x <= 180; x += kPeriodPx) {
        bool parts_disagree = false;
        const auto match = MatchAt(Eigen::Vector2d(x, y), &parts_disagree);
        num_refused += !match || parts_disagree ? 1 : 0;
      }
    }
    return num_refused;
  }
};

TEST_F(ReliefTest, ACentreThatMovesUnlikeTheWholeIsRefused) {
  EXPECT_EQ(NumRefused(0.0), 0);
  EXPECT_LE(NumRefused(0.1), 2) << "less than it is allowed to";
  EXPECT_GE(NumRefused(0.8), 12);
}

TEST_F(ReliefTest, HowFarTheCentreMayBeOffIsAnOption) {
  const int num_refused = NumRefused(0.6);
  options_.max_center_shift_px = 10.0;
  EXPECT_LT(NumRefused(0.6), num_refused) << "the quarters alone see less of it";
}

TEST(ReachableNcc, FallsWithTheNoise) {
  EXPECT_DOUBLE_EQ(ReachableNcc(10.0, 0.0), 1.0);
  EXPECT_DOUBLE_EQ(ReachableNcc(10.0, 5.0), 0.75);
  EXPECT_DOUBLE_EQ(ReachableNcc(5.0, 10.0), 0.0);
  EXPECT_DOUBLE_EQ(ReachableNcc(0.0, 1.0), 0.0);
}

}  // namespace
}  // namespace scenecalib
