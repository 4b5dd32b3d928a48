#include "scenecalib/segment/segment_chooser.h"

#include <gtest/gtest.h>

#include <cmath>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kRate_hz = 50.0;

/// A drive integrated step by step: nearly straight at constant speed, with noise, except where
/// `winding` says; there it turns and changes speed.
class Drive {
 public:
  template <typename IsWinding>
  Drive(double duration_s, const IsWinding& is_winding, SegmentChooser* chooser) {
    Random random(3);
    const int num_steps = static_cast<int>(duration_s * kRate_hz);
    for (int i = 0; i < num_steps; ++i) {
      const double t = i / kRate_hz;
      const bool winding = is_winding(length_m_);
      const double speed_m_s = winding ? 8.0 + 3.0 * std::sin(0.5 * t) : 16.0;
      const double yaw_rate = winding ? 0.35 * std::sin(0.4 * t) : 0.004 * std::sin(0.05 * t);
      const double pitch_rate = (winding ? 0.02 : 0.003) * std::sin(7.0 * t);
      pose_ = pose_ * Rigid3(ExpSo3({0.0, pitch_rate / kRate_hz,
                                     yaw_rate / kRate_hz + 1e-4 * random.Gaussian()}),
                             {speed_m_s / kRate_hz + 1e-3 * random.Gaussian(), 0.0, 0.0});
      length_m_ += speed_m_s / kRate_hz;
      stamps_.push_back(static_cast<Timestamp>(i * 1e9 / kRate_hz));
      lengths_.push_back(length_m_);
      chooser->Add({stamps_.back(), pose_});
    }
  }

  double LengthAt(Timestamp stamp_ns) const {
    const auto at = std::lower_bound(stamps_.begin(), stamps_.end(), stamp_ns);
    return lengths_[std::min<std::size_t>(at - stamps_.begin(), lengths_.size() - 1)];
  }
  Timestamp end_ns() const { return stamps_.back(); }
  const Rigid3& pose() const { return pose_; }

 private:
  Rigid3 pose_;
  double length_m_ = 0.0;
  std::vector<Timestamp> stamps_;
  std::vector<double> lengths_;
};

/// Five kilometres of an hour's drive that are worth it.
const double kPlanted_m[] = {4000.0, 13000.0, 21500.0, 33000.0, 41000.0};

bool IsPlanted(double length_m) {
  for (const double start_m : kPlanted_m) {
    if (length_m >= start_m && length_m < start_m + 1000.0) return true;
  }
  return false;
}

TEST(SegmentChooser, FindsTheGoodKilometresOfAnHour) {
  SegmentChooser chooser((SegmentChoiceOptions()));
  const Drive drive(3600.0, IsPlanted, &chooser);
  const std::vector<DriveSegment> segments = chooser.Choose();
  ASSERT_EQ(segments.size(), 5u);
  int num_found = 0;
  for (const double start_m : kPlanted_m) {
    double covered_m = 0.0;
    for (const DriveSegment& segment : segments) {
      const double from_m = std::max(start_m, drive.LengthAt(segment.start_ns));
      const double to_m = std::min(start_m + 1000.0, drive.LengthAt(segment.end_ns));
      covered_m += std::max(0.0, to_m - from_m);
    }
    if (covered_m > 800.0) ++num_found;
  }
  EXPECT_EQ(num_found, 5);
  for (const DriveSegment& segment : segments) {
    EXPECT_LE(segment.length_m, 1000.0 + 20.0);  // and a bin
    EXPECT_GT(segment.turn_rad, 5.0);
  }
}

TEST(SegmentChooser, StretchesDoNotOverlapAndTheBestComesFirst) {
  SegmentChooser chooser((SegmentChoiceOptions()));
  const Drive drive(
      1500.0, [](double at_m) { return at_m > 3000.0 && at_m < 9000.0; }, &chooser);
  const std::vector<DriveSegment> segments = chooser.Choose();
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const double best_so_far = i > 0 ? segments[i - 1].score : segments[i].score;
    EXPECT_LE(segments[i].score, best_so_far + 1e-9);
    for (std::size_t k = 0; k < i; ++k) {
      EXPECT_TRUE(segments[i].end_ns <= segments[k].start_ns ||
                  segments[k].end_ns <= segments[i].start_ns);
    }
  }
}

TEST(SegmentChooser, MemoryStaysBoundedAndTheGoodKilometresAreFoundAllTheSame) {
  SegmentChoiceOptions options;
  options.max_bins = 1000;
  SegmentChooser chooser(options);
  const Drive drive(3600.0, IsPlanted, &chooser);
  EXPECT_LE(chooser.num_bins(), options.max_bins);
  int num_winding = 0;
  for (const DriveSegment& segment : chooser.Choose()) num_winding += segment.turn_rad > 5.0;
  EXPECT_GE(num_winding, 4);
}

TEST(SegmentChooser, StandingStillIsNotWorthIt) {
  SegmentChoiceOptions options;
  options.min_recording_m = 0.0;
  SegmentChooser chooser(options);
  for (int i = 0; i < 5000; ++i) chooser.Add({i * 20000000LL, Rigid3()});
  EXPECT_TRUE(chooser.Choose().empty());
}

TEST(SegmentChooser, AShortRecordingIsUsedAsAWhole) {
  SegmentChooser chooser((SegmentChoiceOptions()));
  const Drive drive(
      60.0, [](double) { return true; }, &chooser);
  EXPECT_GT(chooser.path_length_m(), 300.0);
  EXPECT_TRUE(chooser.Choose().empty());
}

TEST(SegmentChooser, NoStretchGoesOverAGap) {
  SegmentChoiceOptions options;
  options.min_recording_m = 0.0;
  SegmentChooser chooser(options);
  const Drive first(
      40.0, [](double) { return true; }, &chooser);
  const Timestamp gap_end_ns = first.end_ns() + 30000000000LL;
  for (int i = 0; i < 2000; ++i) {
    chooser.Add(
        {gap_end_ns + i * 20000000LL,
         first.pose() * Rigid3(ExpSo3({0.0, 0.0, 0.3 * std::sin(0.01 * i)}), {0.1 * i, 0.0, 0.0})});
  }
  for (const DriveSegment& segment : chooser.Choose()) {
    EXPECT_TRUE(segment.end_ns <= first.end_ns() || segment.start_ns >= gap_end_ns);
  }
}

TEST(SegmentChooser, StampsThatRunBackwardsAreSkipped) {
  SegmentChoiceOptions options;
  options.min_recording_m = 0.0;
  SegmentChooser chooser(options);
  chooser.Add({1000, Rigid3()});
  chooser.Add({500, Rigid3(Eigen::Quaterniond::Identity(), {1000.0, 0.0, 0.0})});
  EXPECT_EQ(chooser.path_length_m(), 0.0);
}

}  // namespace
}  // namespace scenecalib
