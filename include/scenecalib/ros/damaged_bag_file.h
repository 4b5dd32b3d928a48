#pragma once

#include <cstddef>
#include <cstdint>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "scenecalib/ros/bag_recording.h"

namespace scenecalib {

/// A bag (format 2.0) without a usable index, e.g. because the recorder died: its chunks are walked
/// through once to note where every message lies, then read like any other. What is cut off or
/// damaged is left out and told. rosbag's C++ library refuses such files.
class DamagedBagFile : public BagFile {
 public:
  static Result<std::unique_ptr<BagFile>> Open(const std::string& path);

  std::vector<BagTopic> topics() const override;
  Timestamp begin_ns() const override { return entries_.front().receipt_ns; }
  Timestamp end_ns() const override { return entries_.back().receipt_ns; }
  void Rewind(const std::set<std::string>& topics, const ReceiptWindow& window) override;
  bool Next(BagMessage* message) override;
  int num_unreadable() const override { return 0; }  // found while walking, see damage()
  std::string damage() const override;

 private:
  struct Connection {
    std::string topic;
    std::string datatype;
    std::string md5sum;
  };
  /// Where one message's bytes lie: in a chunk, or, without chunks, in the file itself.
  struct Entry {
    Timestamp receipt_ns = 0;
    std::uint32_t connection = 0;
    int chunk = -1;
    std::uint64_t offset = 0;  ///< of its bytes in the chunk's content or in the file
    std::uint32_t size = 0;
  };
  struct Chunk {
    std::uint64_t position = 0;  ///< of the compressed bytes in the file
    std::uint32_t size = 0;      ///< of the compressed bytes
    std::uint32_t content_size = 0;
    std::string compression;
  };
  using Fields = std::map<std::string, std::string>;
  using Bytes = std::vector<std::uint8_t>;

  Status Walk(const std::string& path);
  bool ReadBytes(std::uint64_t position, std::uint64_t size, Bytes* bytes);
  void WalkChunk(int chunk, const Bytes& content);
  void NoteRecord(const Fields& fields, int chunk, std::uint64_t offset, const Bytes& data,
                  std::uint32_t size);
  bool ReadContent(const Chunk& chunk, Bytes* content);
  static bool ParseFields(const std::uint8_t* data, std::size_t size, Fields* fields);

  std::ifstream file_;
  std::uint64_t file_size_ = 0;
  std::uint64_t walked_bytes_ = 0;  ///< up to here whole records were found
  int num_damaged_chunks_ = 0;
  std::map<std::uint32_t, Connection> connections_;
  std::vector<Chunk> chunks_;
  std::vector<Entry> entries_;  ///< by receipt

  std::set<std::string> wanted_;
  ReceiptWindow window_;
  std::size_t next_ = 0;
  int cached_chunk_ = -1;
  Bytes cached_content_;
};

}  // namespace scenecalib
