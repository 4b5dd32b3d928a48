#pragma once

#include <cstddef>
#include <map>
#include <opencv2/core.hpp>
#include <string>

#include "scenecalib/base/status.h"
#include "scenecalib/base/timestamp.h"

namespace scenecalib {

/// The same pixels in a temporary file of their own, mapped into memory: the system reads them in
/// when they are looked at and takes the memory back when it is short of it. The file has no name
/// and goes with the last cv::Mat that shares its pixels. kUnavailable when the directory cannot be
/// written to or is full. `directory` empty: $TMPDIR, else /tmp.
Result<cv::Mat> MoveToFile(const cv::Mat& image, const std::string& directory = "");

/// Images by stamp in memory that does not grow beyond a bound: the newest are ordinary memory, the
/// older ones are moved to files. Every image stays readable as it was, by any number of threads,
/// and images handed out stay valid after the store has forgotten them.
class ImageStore {
 public:
  /// `max_bytes` is what may stay in ordinary memory; `directory` as for MoveToFile.
  explicit ImageStore(std::size_t max_bytes, std::string directory = "");

  /// Keeps an image whose pixels nobody else writes to, newer than all before. kUnavailable when an
  /// older one could not be moved to a file: it stays in memory, beyond the bound.
  Status Add(Timestamp stamp_ns, const cv::Mat& image);

  /// Forgets an image; nothing happens when it is not there.
  void Remove(Timestamp stamp_ns);

  const std::map<Timestamp, cv::Mat>& images() const { return images_; }
  /// Of the images that are in ordinary memory.
  std::size_t bytes_in_memory() const { return bytes_in_memory_; }

 private:
  std::size_t max_bytes_;
  std::string directory_;
  std::map<Timestamp, cv::Mat> images_;
  std::size_t bytes_in_memory_ = 0;
  Timestamp first_in_memory_ns_ = 0;  ///< all before are in files
};

}  // namespace scenecalib
