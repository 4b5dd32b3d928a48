#include "scenecalib/tracking/image_store.h"

#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <atomic>

namespace scenecalib {
namespace {

constexpr int kEdge = 64;
constexpr std::size_t kImageBytes = kEdge * kEdge;

cv::Mat Numbered(int i) {
  cv::Mat image(kEdge, kEdge, CV_8UC1);
  for (int y = 0; y < kEdge; ++y) {
    for (int x = 0; x < kEdge; ++x) image.at<uchar>(y, x) = static_cast<uchar>(7 * i + 3 * x + y);
  }
  return image;
}

bool IsSame(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() && cv::norm(a, b, cv::NORM_INF) == 0.0;
}

TEST(ImageStore, KeepsEveryImageAsItWasBeyondItsBound) {
  ImageStore store(3 * kImageBytes);
  for (int i = 0; i < 20; ++i) {
    ASSERT_TRUE(store.Add(100 + i, Numbered(i)).ok());
    EXPECT_LE(store.bytes_in_memory(), 3 * kImageBytes);
  }
  ASSERT_EQ(store.images().size(), 20U);
  for (int i = 0; i < 20; ++i) EXPECT_TRUE(IsSame(store.images().at(100 + i), Numbered(i))) << i;
}

TEST(ImageStore, LeavesImagesAloneBelowItsBound) {
  ImageStore store(3 * kImageBytes);
  const cv::Mat first = Numbered(1);
  ASSERT_TRUE(store.Add(1, first).ok());
  ASSERT_TRUE(store.Add(2, Numbered(2)).ok());
  EXPECT_EQ(store.images().at(1).data, first.data) << "shared, not copied";
  EXPECT_EQ(store.bytes_in_memory(), 2 * kImageBytes);
}

TEST(ImageStore, MovesAllToFilesWithoutAnyMemory) {
  ImageStore store(0);
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(store.Add(i, Numbered(i)).ok());
  EXPECT_EQ(store.bytes_in_memory(), 0U);
  EXPECT_TRUE(IsSame(store.images().at(1), Numbered(1)));
}

TEST(ImageStore, ImagesOutliveTheStore) {
  std::map<Timestamp, cv::Mat> kept;
  {
    ImageStore store(kImageBytes);
    for (int i = 0; i < 4; ++i) ASSERT_TRUE(store.Add(i, Numbered(i)).ok());
    kept = store.images();
    store.Remove(0);
    EXPECT_EQ(store.images().size(), 3U);
  }
  for (int i = 0; i < 4; ++i) EXPECT_TRUE(IsSame(kept.at(i), Numbered(i))) << i;
}

TEST(ImageStore, CountsWhatIsRemovedFromMemoryOnly) {
  ImageStore store(2 * kImageBytes);
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(store.Add(i, Numbered(i)).ok());
  store.Remove(0);  // in a file
  EXPECT_EQ(store.bytes_in_memory(), 2 * kImageBytes);
  store.Remove(2);
  EXPECT_EQ(store.bytes_in_memory(), kImageBytes);
  store.Remove(2);  // not there any more
  store.Remove(3);
  EXPECT_EQ(store.bytes_in_memory(), 0U);
  ASSERT_TRUE(store.Add(9, Numbered(9)).ok());
  EXPECT_EQ(store.bytes_in_memory(), kImageBytes);
}

TEST(ImageStore, ManyThreadsReadTheSamePixels) {
  ImageStore store(0);
  for (int i = 0; i < 8; ++i) ASSERT_TRUE(store.Add(i, Numbered(i)).ok());
  std::atomic<int> num_wrong{0};
  tbb::parallel_for(0, 200, [&](int i) {
    const cv::Mat shared = store.images().at(i % 8);
    if (!IsSame(shared, Numbered(i % 8))) ++num_wrong;
  });
  EXPECT_EQ(num_wrong, 0);
}

TEST(ImageStore, SaysWhereItCannotWriteAndKeepsTheImage) {
  ImageStore store(0, "/nowhere/at/all");
  const Status status = store.Add(1, Numbered(1));
  ASSERT_FALSE(status.ok());
  EXPECT_EQ(status.code(), Status::Code::kUnavailable);
  EXPECT_NE(status.message().find("/nowhere/at/all"), std::string::npos);
  EXPECT_TRUE(IsSame(store.images().at(1), Numbered(1)));
  EXPECT_FALSE(store.Add(1, Numbered(1)).ok()) << "repeated stamp";
}

TEST(MoveToFile, KeepsColourAndPartsOfImages) {
  cv::Mat colour(20, 30, CV_8UC3, cv::Scalar(1, 2, 3));
  const cv::Mat part = colour(cv::Rect(5, 5, 10, 10));
  const auto moved = MoveToFile(part);
  ASSERT_TRUE(moved.ok());
  EXPECT_TRUE(IsSame(*moved, part));
  EXPECT_NE(moved->data, part.data);
  EXPECT_TRUE(MoveToFile(cv::Mat()).ok()) << "nothing to move";
}

}  // namespace
}  // namespace scenecalib
