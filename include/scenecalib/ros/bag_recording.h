#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/base/timestamp.h"

namespace scenecalib {

/// A topic of a bag.
struct BagTopic {
  std::string name;
  std::string datatype;  ///< "sensor_msgs/PointCloud2"
  std::string md5sum;    ///< of the message definition
  int num_messages = 0;
};

/// One serialised message as it lies in a bag.
struct BagMessage {
  std::string topic;
  std::string datatype;
  std::string md5sum;
  Timestamp receipt_ns = 0;  ///< when it was recorded, not its header's stamp
  std::vector<std::uint8_t> bytes;
};

/// Messages received from begin to end, both included.
struct ReceiptWindow {
  Timestamp begin_ns = 0;
  Timestamp end_ns = 4000000000000000000LL;  ///< the year 2096
};

/// The messages of one bag file in the order of their receipt.
class BagFile {
 public:
  virtual ~BagFile() = default;
  virtual std::vector<BagTopic> topics() const = 0;
  /// Receipt of the first and last message.
  virtual Timestamp begin_ns() const = 0;
  virtual Timestamp end_ns() const = 0;
  /// Starts over, with the messages of these topics in this window only.
  virtual void Rewind(const std::set<std::string>& topics, const ReceiptWindow& window) = 0;
  /// False at the end. A message that cannot be read is skipped and counted.
  virtual bool Next(BagMessage* message) = 0;
  virtual int num_unreadable() const = 0;
  /// What of the file could not be read, for a person; empty when all could.
  virtual std::string damage() const = 0;
};

/// Opens an intact bag by its index (rosbag), any other by walking through its chunks: a recorder
/// that died leaves neither index nor, at the end, a whole chunk. NotFound when there is no file,
/// InvalidArgument when it is not a bag or nothing in it is readable.
Result<std::unique_ptr<BagFile>> OpenBagFile(const std::string& path);

/// Bags read directly, together: split files or one per sensor group; bz2, lz4 or uncompressed;
/// intact or ending in the middle of a chunk.
class BagRecording {
 public:
  static Result<BagRecording> Open(const std::vector<std::string>& paths);

  /// Receipt of the first and last message of all bags.
  Timestamp begin_ns() const;
  Timestamp end_ns() const;

  /// Every topic of all bags, by name.
  std::vector<BagTopic> topics() const;

  /// The file names, for messages: "a.bag, b.bag".
  std::string name() const;

  /// Calls `handle` for every message of the topics, merged by receipt over all bags. Stops early
  /// when it returns false. What lies outside the window is not read.
  void ForEachMessage(const std::set<std::string>& topics,
                      const std::function<bool(BagMessage&&)>& handle,
                      const ReceiptWindow& window = ReceiptWindow());

  /// One line per file that could not be read in full (complete after ForEachMessage).
  std::vector<std::string> damages() const;

 private:
  std::vector<std::string> paths_;
  std::vector<std::unique_ptr<BagFile>> files_;
};

}  // namespace scenecalib
