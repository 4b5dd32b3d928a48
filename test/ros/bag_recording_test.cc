#include "scenecalib/ros/bag_recording.h"

#include <gtest/gtest.h>
#include <ros/serialization.h>
#include <rosbag/bag.h>
#include <std_msgs/Int32.h>
#include <std_msgs/String.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

namespace scenecalib {
namespace {

namespace fs = std::filesystem;

constexpr int kNumMessages = 200;

/// Some hundreds of messages of two topics in several chunks; the payload tells them apart.
void WriteBag(const std::string& path, rosbag::CompressionType compression, int first = 0,
              int step = 1) {
  rosbag::Bag bag(path, rosbag::bagmode::Write);
  bag.setCompression(compression);
  bag.setChunkThreshold(16 * 1024);
  for (int i = 0; i < kNumMessages; ++i) {
    const int value = first + i * step;
    std_msgs::Int32 number;
    number.data = value;
    std_msgs::String text;
    text.data = std::string(500, static_cast<char>('a' + value % 26));
    bag.write("/number", ros::Time(100.0 + 0.01 * value), number);
    bag.write("/text", ros::Time(100.005 + 0.01 * value), text);
  }
  bag.close();
}

/// As a recorder that died leaves it: the rest of the file is missing.
void CutOff(const std::string& path, double share) {
  fs::resize_file(path,
                  static_cast<std::uintmax_t>(share * static_cast<double>(fs::file_size(path))));
}

std::vector<int> Numbers(BagRecording* recording) {
  std::vector<int> numbers;
  recording->ForEachMessage({"/number"}, [&numbers](BagMessage&& message) {
    std_msgs::Int32 number;
    ros::serialization::IStream stream(message.bytes.data(),
                                       static_cast<std::uint32_t>(message.bytes.size()));
    ros::serialization::deserialize(stream, number);
    numbers.push_back(number.data);
    return true;
  });
  return numbers;
}

class BagRecordingTest : public testing::TestWithParam<rosbag::CompressionType> {
 protected:
  void SetUp() override {
    const testing::TestInfo* info = testing::UnitTest::GetInstance()->current_test_info();
    std::string name = std::string("scenecalib_") + info->name();
    for (char& c : name) c = c == '/' ? '_' : c;
    directory_ = fs::path(testing::TempDir()) / name;
    fs::remove_all(directory_);
    fs::create_directories(directory_);
  }
  void TearDown() override { fs::remove_all(directory_); }
  std::string Path(const std::string& name) const { return (directory_ / name).string(); }
  fs::path directory_;
};

TEST_P(BagRecordingTest, ReadsOnlyTheWindowAskedForAlsoWithoutTheIndex) {
  for (const bool cut : {false, true}) {
    const std::string path = Path(cut ? "cut.bag" : "whole.bag");
    WriteBag(path, GetParam());  // 200 numbers, one every 10 ms
    if (cut) CutOff(path, 0.9);
    Result<BagRecording> recording = BagRecording::Open({path});
    ASSERT_TRUE(recording.ok()) << recording.status().message();
    std::vector<Timestamp> receipts_ns;
    recording->ForEachMessage({"/number"},
                              [&receipts_ns](BagMessage&& message) {
                                receipts_ns.push_back(message.receipt_ns);
                                return true;
                              },
                              {100500000000LL, 100600000000LL});
    ASSERT_EQ(receipts_ns.size(), 11u);  // one every 10 ms, both ends included
    EXPECT_EQ(receipts_ns.front(), 100500000000LL);
    EXPECT_EQ(receipts_ns.back(), 100600000000LL);
  }
}

TEST_P(BagRecordingTest, ReadsAnIntactBagInOrder) {
  WriteBag(Path("a.bag"), GetParam());
  Result<BagRecording> recording = BagRecording::Open({Path("a.bag")});
  ASSERT_TRUE(recording.ok()) << recording.status().message();
  const std::vector<int> numbers = Numbers(&*recording);
  ASSERT_EQ(numbers.size(), static_cast<std::size_t>(kNumMessages));
  for (int i = 0; i < kNumMessages; ++i) EXPECT_EQ(numbers[static_cast<std::size_t>(i)], i);
  EXPECT_TRUE(recording->damages().empty());
  ASSERT_EQ(recording->topics().size(), 2U);
  EXPECT_EQ(recording->topics()[0].name, "/number");
  EXPECT_EQ(recording->topics()[0].datatype, "std_msgs/Int32");
  EXPECT_EQ(recording->topics()[0].num_messages, kNumMessages);
}

TEST_P(BagRecordingTest, ReadsWhatIsLeftOfABagThatEndsInTheMiddleOfAChunk) {
  WriteBag(Path("a.bag"), GetParam());
  CutOff(Path("a.bag"), 0.6);
  Result<BagRecording> recording = BagRecording::Open({Path("a.bag")});
  ASSERT_TRUE(recording.ok()) << recording.status().message();
  const std::vector<int> numbers = Numbers(&*recording);
  ASSERT_GT(numbers.size(), 10U);
  EXPECT_LT(numbers.size(), static_cast<std::size_t>(kNumMessages));
  for (std::size_t i = 0; i < numbers.size(); ++i) EXPECT_EQ(numbers[i], static_cast<int>(i));
  ASSERT_EQ(recording->damages().size(), 1U);
  EXPECT_NE(recording->damages()[0].find("a.bag"), std::string::npos);
}

TEST_P(BagRecordingTest, NeverFailsWhereverABagIsCutOff) {
  WriteBag(Path("a.bag"), GetParam());
  for (double share = 0.0; share < 1.0; share += 0.03) {
    fs::copy_file(Path("a.bag"), Path("cut.bag"), fs::copy_options::overwrite_existing);
    CutOff(Path("cut.bag"), share);
    Result<BagRecording> recording = BagRecording::Open({Path("cut.bag")});
    if (!recording.ok()) {
      EXPECT_NE(recording.status().message().find("cut.bag"), std::string::npos);
      continue;
    }
    const std::vector<int> numbers = Numbers(&*recording);
    for (std::size_t i = 0; i < numbers.size(); ++i) EXPECT_EQ(numbers[i], static_cast<int>(i));
  }
}

INSTANTIATE_TEST_SUITE_P(Compressions, BagRecordingTest,
                         testing::Values(rosbag::compression::Uncompressed,
                                         rosbag::compression::BZ2, rosbag::compression::LZ4));

using BagRecordingFiles = BagRecordingTest;

TEST_P(BagRecordingFiles, MergesSeveralBagsByTime) {
  WriteBag(Path("even.bag"), GetParam(), 0, 2);
  WriteBag(Path("odd.bag"), GetParam(), 1, 2);
  Result<BagRecording> recording = BagRecording::Open({Path("odd.bag"), Path("even.bag")});
  ASSERT_TRUE(recording.ok()) << recording.status().message();
  const std::vector<int> numbers = Numbers(&*recording);
  ASSERT_EQ(numbers.size(), static_cast<std::size_t>(2 * kNumMessages));
  for (std::size_t i = 0; i < numbers.size(); ++i) EXPECT_EQ(numbers[i], static_cast<int>(i));
}

TEST_P(BagRecordingFiles, NamesAFileThatDoesNotExist) {
  const Result<BagRecording> recording = BagRecording::Open({Path("missing.bag")});
  EXPECT_EQ(recording.status().code(), Status::Code::kNotFound);
  EXPECT_NE(recording.status().message().find("missing.bag"), std::string::npos);
}

TEST_P(BagRecordingFiles, RefusesAFileThatIsNoBag) {
  std::ofstream(Path("text.bag")) << "This is not a bag.";
  const Result<BagRecording> recording = BagRecording::Open({Path("text.bag")});
  EXPECT_EQ(recording.status().code(), Status::Code::kInvalidArgument);
  EXPECT_NE(recording.status().message().find("not a ROS bag"), std::string::npos);
}

TEST_P(BagRecordingFiles, RefusesEmptyFilesAndBagsWithoutMessages) {
  std::ofstream(Path("zero.bag")).flush();
  EXPECT_FALSE(BagRecording::Open({Path("zero.bag")}).ok());
  rosbag::Bag(Path("none.bag"), rosbag::bagmode::Write).close();
  const Result<BagRecording> recording = BagRecording::Open({Path("none.bag")});
  EXPECT_EQ(recording.status().code(), Status::Code::kInsufficientData);
  EXPECT_NE(recording.status().message().find("empty"), std::string::npos);
}

TEST_P(BagRecordingFiles, StopsWhenTold) {
  WriteBag(Path("a.bag"), GetParam());
  Result<BagRecording> recording = BagRecording::Open({Path("a.bag")});
  ASSERT_TRUE(recording.ok());
  int num_messages = 0;
  recording->ForEachMessage({"/number", "/text"},
                            [&num_messages](BagMessage&&) { return ++num_messages < 7; });
  EXPECT_EQ(num_messages, 7);
}

INSTANTIATE_TEST_SUITE_P(Once, BagRecordingFiles,
                         testing::Values(rosbag::compression::Uncompressed));

}  // namespace
}  // namespace scenecalib
