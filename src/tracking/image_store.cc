#include "scenecalib/tracking/image_store.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>
#include <vector>

namespace scenecalib {
namespace {

std::size_t BytesOf(const cv::Mat& image) { return image.total() * image.elemSize(); }

/// Unmaps the pixels of the images that MoveToFile made; allocates nothing itself.
class MappedPixels final : public cv::MatAllocator {
 public:
  cv::UMatData* allocate(int dims, const int* sizes, int type, void* data, std::size_t* step,
                         cv::AccessFlag flags, cv::UMatUsageFlags usage) const override {
    return cv::Mat::getStdAllocator()->allocate(dims, sizes, type, data, step, flags, usage);
  }
  bool allocate(cv::UMatData* data, cv::AccessFlag flags, cv::UMatUsageFlags usage) const override {
    return cv::Mat::getStdAllocator()->allocate(data, flags, usage);
  }
  void deallocate(cv::UMatData* data) const override {
    if (data == nullptr) return;
    ::munmap(data->origdata, data->size);
    delete data;
  }
};

Status NoRoom(const std::string& directory, int error) {
  return {Status::Code::kUnavailable,
          "cannot keep images in " + directory + " (" + std::strerror(error) +
              "): free some space or set TMPDIR to a directory with room"};
}

/// Pages of an unnamed file of that many bytes. Space is taken at once: a write into a hole of a
/// full disk would kill the process.
Result<uchar*> MapNewFile(std::size_t num_bytes, const std::string& directory) {
  const std::string pattern = directory + "/scenecalib_image_XXXXXX";
  std::vector<char> name(pattern.begin(), pattern.end());
  name.push_back('\0');
  const int file = ::mkstemp(name.data());
  if (file < 0) return NoRoom(directory, errno);
  ::unlink(name.data());
  const int error = ::posix_fallocate(file, 0, static_cast<off_t>(num_bytes));
  void* bytes = MAP_FAILED;
  if (error == 0) {
    bytes = ::mmap(nullptr, num_bytes, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  }
  const int map_error = errno;
  ::close(file);
  if (bytes == MAP_FAILED) return NoRoom(directory, error != 0 ? error : map_error);
  return static_cast<uchar*>(bytes);
}

}  // namespace

Result<cv::Mat> MoveToFile(const cv::Mat& image, const std::string& directory) {
  if (image.empty()) return image;
  std::error_code ignored;
  const Result<uchar*> bytes = MapNewFile(
      BytesOf(image),
      directory.empty() ? std::filesystem::temp_directory_path(ignored).string() : directory);
  if (!bytes.ok()) return bytes.status();
  // Lives as long as any image may, beyond the end of main.
  static const auto* const kUnmapper = new MappedPixels;
  cv::Mat mapped(image.rows, image.cols, image.type(), *bytes);
  mapped.u = new cv::UMatData(kUnmapper);
  mapped.u->data = mapped.u->origdata = *bytes;
  mapped.u->size = BytesOf(image);
  mapped.u->refcount = 1;
  image.copyTo(mapped);
  // The pixels are the file's now: this process need not hold them until someone looks.
  ::madvise(*bytes, BytesOf(image), MADV_DONTNEED);
  return mapped;
}

ImageStore::ImageStore(std::size_t max_bytes, std::string directory)
    : max_bytes_(max_bytes), directory_(std::move(directory)) {}

Status ImageStore::Add(Timestamp stamp_ns, const cv::Mat& image) {
  if (!images_.empty() && stamp_ns <= images_.rbegin()->first) {
    return Status::InvalidArgument("image store: stamps must increase");
  }
  if (bytes_in_memory_ == 0) first_in_memory_ns_ = stamp_ns;
  images_.emplace(stamp_ns, image);
  bytes_in_memory_ += BytesOf(image);
  while (bytes_in_memory_ > max_bytes_) {
    const auto oldest = images_.lower_bound(first_in_memory_ns_);
    Result<cv::Mat> moved = MoveToFile(oldest->second, directory_);
    if (!moved.ok()) return moved.status();
    bytes_in_memory_ -= BytesOf(oldest->second);
    oldest->second = std::move(moved).value();
    first_in_memory_ns_ = oldest->first + 1;
  }
  return Status::Ok();
}

void ImageStore::Remove(Timestamp stamp_ns) {
  const auto found = images_.find(stamp_ns);
  if (found == images_.end()) return;
  if (stamp_ns >= first_in_memory_ns_) bytes_in_memory_ -= BytesOf(found->second);
  images_.erase(found);
}

}  // namespace scenecalib
