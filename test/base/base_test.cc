// Status, Result, log sink, time and random numbers: small enough for one file.

#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "scenecalib/base/log.h"
#include "scenecalib/base/progress.h"
#include "scenecalib/base/random.h"
#include "scenecalib/base/status.h"
#include "scenecalib/base/timestamp.h"

namespace scenecalib {
namespace {

Result<int> Half(int value) {
  if (value % 2 != 0) return Status::InvalidArgument(std::to_string(value) + " is odd");
  return value / 2;
}

Status CheckHalf(int value) {
  SCENECALIB_RETURN_IF_ERROR(Half(value).status());
  return Status::Ok();
}

TEST(Result, HoldsAValueOrTheReasonWhyThereIsNone) {
  EXPECT_TRUE(Half(4).ok());
  EXPECT_EQ(*Half(4), 2);
  EXPECT_TRUE(Half(4).status().ok());
  EXPECT_FALSE(Half(3));
  EXPECT_EQ(Half(3).status().code(), Status::Code::kInvalidArgument);
  EXPECT_EQ(Half(3).status().message(), "3 is odd");
}

TEST(Status, ReturnIfErrorHandsTheErrorOn) {
  EXPECT_TRUE(CheckHalf(2).ok());
  EXPECT_EQ(CheckHalf(5).message(), "5 is odd");
}

TEST(Log, GoesToTheSinkAndTheOldSinkComesBack) {
  std::vector<std::pair<LogSeverity, std::string>> lines;
  LogSink previous = SetLogSink([&lines](LogSeverity severity, const std::string& message) {
    lines.emplace_back(severity, message);
  });
  Log(LogSeverity::kWarning, "one");
  SetLogSink(nullptr);
  Log(LogSeverity::kError, "nobody listens");
  SetLogSink(std::move(previous));
  ASSERT_EQ(lines.size(), 1u);
  EXPECT_EQ(lines[0].first, LogSeverity::kWarning);
  EXPECT_EQ(lines[0].second, "one");
}

TEST(Log, ASinkMayLogItself) {
  int depth = 0;
  LogSink previous = SetLogSink([&depth](LogSeverity severity, const std::string&) {
    if (++depth < 3) Log(severity, "again");
  });
  Log(LogSeverity::kInfo, "once");
  SetLogSink(std::move(previous));
  EXPECT_EQ(depth, 3);
}

TEST(Progress, WithoutAListenerTheStageGoesOn) {
  EXPECT_TRUE(ReportProgress({}, "mapping", 0.5));
  EXPECT_FALSE(ReportProgress([](const Progress& p) { return p.fraction < 0.5; }, "mapping", 0.5));
}

TEST(Timestamp, DifferencesAndSumsAreExactToTheNanosecond) {
  constexpr Timestamp kStamp = 1700000000123456789;
  EXPECT_EQ(AddSeconds(kStamp, 0.1), kStamp + 100000000);
  EXPECT_EQ(AddSeconds(kStamp, -1e-9), kStamp - 1);
  EXPECT_DOUBLE_EQ(SecondsBetween(kStamp, kStamp + 250000000), 0.25);
  EXPECT_DOUBLE_EQ(SecondsBetween(kStamp, kStamp - 250000000), -0.25);
}

TEST(Random, IsTheSameWithEveryStandardLibrary) {
  // SplitMix64's published sequence for seed 1234567.
  Random random(1234567);
  EXPECT_EQ(random.NextBits(), 6457827717110365317ULL);
  EXPECT_EQ(random.NextBits(), 3203168211198807973ULL);
}

TEST(Random, HasTheMomentsOfItsDistributions) {
  constexpr int kCount = 100000;
  constexpr double kTolerance = 0.02;  // four standard errors or more
  Random random(7);
  double sum = 0.0, sum_squares = 0.0, uniform_sum = 0.0;
  for (int i = 0; i < kCount; ++i) {
    const double gaussian = random.Gaussian();
    sum += gaussian;
    sum_squares += gaussian * gaussian;
    const double uniform = random.Uniform(2.0, 4.0);
    ASSERT_GE(uniform, 2.0);
    ASSERT_LT(uniform, 4.0);
    uniform_sum += uniform;
    ASSERT_LT(random.Index(5), 5u);
  }
  EXPECT_NEAR(sum / kCount, 0.0, kTolerance);
  EXPECT_NEAR(sum_squares / kCount, 1.0, kTolerance);
  EXPECT_NEAR(uniform_sum / kCount, 3.0, kTolerance);
}

TEST(Random, ForksAreIndependentOfEachOtherAndOfTheirParentsUse) {
  const Random parent(3);
  std::set<std::uint64_t> firsts;
  for (std::uint64_t stream = 0; stream < 100; ++stream) {
    firsts.insert(parent.Fork(stream).NextBits());
  }
  EXPECT_EQ(firsts.size(), 100u);
  EXPECT_EQ(parent.Fork(5).NextBits(), Random(3).Fork(5).NextBits());
}

}  // namespace
}  // namespace scenecalib
