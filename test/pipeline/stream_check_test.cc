#include "scenecalib/pipeline/stream_check.h"

#include <gtest/gtest.h>

namespace scenecalib {
namespace {

constexpr Timestamp kPeriodNs = 100000000;

StreamCheck Regular(int count) {
  StreamCheck check("lidar (/points)");
  for (int i = 0; i < count; ++i) EXPECT_TRUE(check.Note(kPeriodNs * (i + 1)).ok());
  return check;
}

TEST(StreamCheck, AcceptsARegularStreamWithoutAWord) {
  const StreamCheck check = Regular(20);
  EXPECT_TRUE(check.Check({}, true).ok());
  EXPECT_EQ(check.Warning(), "");
  EXPECT_EQ(check.num_used(), 20);
}

TEST(StreamCheck, RefusesAnEmptyStreamByName) {
  const Status status = StreamCheck("lidar (/points)").Check({}, true);
  EXPECT_EQ(status.code(), Status::Code::kInsufficientData);
  EXPECT_NE(status.message().find("/points"), std::string::npos);
}

TEST(StreamCheck, SkipsOneStampThatRunsBackwardsAndSaysSo) {
  StreamCheck check = Regular(40);
  EXPECT_EQ(check.Note(kPeriodNs).code(), Status::Code::kInvalidArgument);
  EXPECT_TRUE(check.Check({}, true).ok());
  EXPECT_NE(check.Warning().find("1 messages skipped"), std::string::npos) << check.Warning();
  EXPECT_EQ(check.num_used(), 40);
}

TEST(StreamCheck, RefusesAStreamWhoseStampsKeepRunningBackwards) {
  StreamCheck check = Regular(20);
  for (int i = 0; i < 5; ++i) EXPECT_FALSE(check.Note(kPeriodNs * (i + 1)).ok());
  const Status status = check.Check({}, true);
  EXPECT_EQ(status.code(), Status::Code::kInvalidArgument);
  EXPECT_NE(status.message().find("5 times in 25"), std::string::npos) << status.message();
}

TEST(StreamCheck, RefusesAJumpForTheLidarButNotForACamera) {
  StreamCheck check = Regular(20);
  EXPECT_TRUE(check.Note(kPeriodNs * 520).ok());
  const Status status = check.Check({}, true);
  EXPECT_EQ(status.code(), Status::Code::kInvalidArgument);
  EXPECT_NE(status.message().find("jump by 50.000 s"), std::string::npos) << status.message();
  EXPECT_TRUE(check.Check({}, false).ok());
}

TEST(StreamCheck, RefusesAStreamOfWhichNothingCouldBeDecodedAndGivesTheFirstReason) {
  StreamCheck check("camera front (/image)");
  check.NoteUndecoded("neither JPEG nor PNG");
  check.NoteUndecoded("something else");
  const Status status = check.Check({}, false);
  EXPECT_EQ(status.code(), Status::Code::kInsufficientData);
  EXPECT_NE(status.message().find("neither JPEG nor PNG"), std::string::npos) << status.message();
}

}  // namespace
}  // namespace scenecalib
