#include "scenecalib/ros/damaged_bag_file.h"

#include <bzlib.h>
#include <roslz4/lz4s.h>

#include <algorithm>
#include <cstring>
#include <memory>

// Format: http://wiki.ros.org/Bags/Format/2.0. A record is <header length><header><data
// length><data>; a header is a list of <field length><name>=<value>. All little-endian.
namespace scenecalib {
namespace {

constexpr char kMagic[] = "#ROSBAG V2.0\n";
constexpr std::uint8_t kOpMessage = 0x02;
constexpr std::uint8_t kOpChunk = 0x05;
constexpr std::uint8_t kOpConnection = 0x07;
/// Larger than any sane record header; a length beyond it is damage.
constexpr std::uint32_t kMaxHeaderBytes = 1U << 20;
/// A chunk that claims to be larger than this is damage (rosbag's default is 768 KiB).
constexpr std::uint32_t kMaxChunkBytes = 1U << 30;

std::uint32_t ReadUint32(const std::uint8_t* data) {
  return static_cast<std::uint32_t>(data[0]) | static_cast<std::uint32_t>(data[1]) << 8 |
         static_cast<std::uint32_t>(data[2]) << 16 | static_cast<std::uint32_t>(data[3]) << 24;
}

std::uint32_t Uint32Field(const std::map<std::string, std::string>& fields, const char* name) {
  const auto found = fields.find(name);
  if (found == fields.end() || found->second.size() < 4) return 0;
  return ReadUint32(reinterpret_cast<const std::uint8_t*>(found->second.data()));
}

std::string StringField(const std::map<std::string, std::string>& fields, const char* name) {
  const auto found = fields.find(name);
  return found == fields.end() ? std::string() : found->second;
}

std::uint8_t Op(const std::map<std::string, std::string>& fields) {
  const std::string op = StringField(fields, "op");
  return op.size() == 1 ? static_cast<std::uint8_t>(op[0]) : 0;
}

}  // namespace

Result<std::unique_ptr<BagFile>> DamagedBagFile::Open(const std::string& path) {
  auto bag = std::make_unique<DamagedBagFile>();
  const Status status = bag->Walk(path);
  if (!status.ok()) return status;
  return std::unique_ptr<BagFile>(std::move(bag));
}

bool DamagedBagFile::ParseFields(const std::uint8_t* data, std::size_t size, Fields* fields) {
  fields->clear();
  std::size_t at = 0;
  while (at < size) {
    if (size - at < 4) return false;
    const std::uint32_t length = ReadUint32(data + at);
    at += 4;
    if (length > size - at) return false;
    const std::string field(reinterpret_cast<const char*>(data + at), length);
    const std::size_t equals = field.find('=');
    if (equals == std::string::npos) return false;
    (*fields)[field.substr(0, equals)] = field.substr(equals + 1);
    at += length;
  }
  return true;
}

bool DamagedBagFile::ReadBytes(std::uint64_t position, std::uint64_t size, Bytes* bytes) {
  if (position > file_size_ || size > file_size_ - position) return false;
  bytes->resize(size);
  file_.clear();
  file_.seekg(static_cast<std::streamoff>(position));
  file_.read(reinterpret_cast<char*>(bytes->data()), static_cast<std::streamsize>(size));
  return static_cast<std::uint64_t>(file_.gcount()) == size;
}

bool DamagedBagFile::ReadContent(const Chunk& chunk, Bytes* content) {
  // The last chunk may be cut off: of an uncompressed one, the part that is there still counts.
  const std::uint64_t available =
      std::min<std::uint64_t>(chunk.size, file_size_ - std::min(file_size_, chunk.position));
  Bytes packed;
  if (!ReadBytes(chunk.position, available, &packed)) return false;
  if (chunk.compression == "none") {
    *content = std::move(packed);
    return true;
  }
  content->resize(chunk.content_size);
  unsigned int size = chunk.content_size;
  char* input = reinterpret_cast<char*>(packed.data());
  char* output = reinterpret_cast<char*>(content->data());
  const auto packed_size = static_cast<unsigned int>(packed.size());
  if (chunk.compression == "bz2") {
    return BZ2_bzBuffToBuffDecompress(output, &size, input, packed_size, 0, 0) == BZ_OK &&
           size == chunk.content_size;
  }
  return chunk.compression == "lz4" &&
         roslz4_buffToBuffDecompress(input, packed_size, output, &size) == ROSLZ4_OK &&
         size == chunk.content_size;
}

void DamagedBagFile::NoteRecord(const Fields& fields, int chunk, std::uint64_t offset,
                                const Bytes& data, std::uint32_t size) {
  if (Op(fields) == kOpConnection) {
    Fields details;
    if (!ParseFields(data.data(), data.size(), &details)) return;
    connections_[Uint32Field(fields, "conn")] = {
        StringField(fields, "topic"), StringField(details, "type"), StringField(details, "md5sum")};
  } else if (Op(fields) == kOpMessage) {
    const std::string time = StringField(fields, "time");
    if (time.size() != 8) return;
    const auto* bytes = reinterpret_cast<const std::uint8_t*>(time.data());
    Entry entry;
    entry.receipt_ns = static_cast<Timestamp>(ReadUint32(bytes)) * 1000000000 +
                       static_cast<Timestamp>(ReadUint32(bytes + 4));
    entry.connection = Uint32Field(fields, "conn");
    entry.chunk = chunk;
    entry.offset = offset;
    entry.size = size;
    entries_.push_back(entry);
  }
}

void DamagedBagFile::WalkChunk(int chunk, const Bytes& content) {
  std::size_t at = 0;
  while (content.size() - at >= 8) {
    const std::uint32_t header_size = ReadUint32(content.data() + at);
    if (header_size > content.size() - at - 8) return;
    Fields fields;
    if (!ParseFields(content.data() + at + 4, header_size, &fields)) return;
    at += 4 + header_size;
    const std::uint32_t size = ReadUint32(content.data() + at);
    at += 4;
    if (size > content.size() - at) return;
    Bytes data;
    if (Op(fields) == kOpConnection) data.assign(&content[at], &content[at] + size);
    NoteRecord(fields, chunk, at, data, size);
    at += size;
  }
}

Status DamagedBagFile::Walk(const std::string& path) {
  file_.open(path, std::ios::binary);
  if (!file_) return Status::NotFound(path + " cannot be opened");
  file_.seekg(0, std::ios::end);
  file_size_ = static_cast<std::uint64_t>(file_.tellg());
  Bytes bytes;
  const std::size_t magic_size = std::strlen(kMagic);
  if (!ReadBytes(0, magic_size, &bytes) || std::memcmp(bytes.data(), kMagic, magic_size) != 0) {
    return Status::InvalidArgument(path + " is not a ROS bag of format 2.0 (" +
                                   std::to_string(file_size_) + " bytes)");
  }
  std::uint64_t at = magic_size;
  Fields fields;
  while (true) {
    walked_bytes_ = at;
    if (!ReadBytes(at, 4, &bytes)) break;
    const std::uint32_t header_size = ReadUint32(bytes.data());
    if (header_size > kMaxHeaderBytes || !ReadBytes(at + 4, header_size, &bytes) ||
        !ParseFields(bytes.data(), bytes.size(), &fields)) {
      break;
    }
    at += 4 + header_size;
    if (!ReadBytes(at, 4, &bytes)) break;
    const std::uint32_t data_size = ReadUint32(bytes.data());
    at += 4;
    if (Op(fields) == kOpChunk) {
      const Chunk chunk{at, data_size, Uint32Field(fields, "size"),
                        StringField(fields, "compression")};
      Bytes content;
      if (chunk.content_size <= kMaxChunkBytes && ReadContent(chunk, &content)) {
        chunks_.push_back(chunk);
        WalkChunk(static_cast<int>(chunks_.size()) - 1, content);
      } else {
        ++num_damaged_chunks_;
      }
    } else if (Op(fields) == kOpConnection || Op(fields) == kOpMessage) {
      Bytes data;
      if (!ReadBytes(at, data_size, &data)) break;
      NoteRecord(fields, -1, at, data, data_size);
    }
    at += data_size;
    if (at > file_size_) break;
  }
  entries_.erase(
      std::remove_if(entries_.begin(), entries_.end(),
                     [this](const Entry& e) { return connections_.count(e.connection) == 0; }),
      entries_.end());
  std::stable_sort(entries_.begin(), entries_.end(),
                   [](const Entry& a, const Entry& b) { return a.receipt_ns < b.receipt_ns; });
  if (entries_.empty()) {
    return Status::InvalidArgument(path + " holds no readable message (" +
                                   std::to_string(file_size_) + " bytes, no index)");
  }
  return Status::Ok();
}

std::vector<BagTopic> DamagedBagFile::topics() const {
  std::map<std::string, BagTopic> by_name;
  for (const Entry& entry : entries_) {
    const Connection& connection = connections_.at(entry.connection);
    BagTopic& topic = by_name[connection.topic];
    topic.name = connection.topic;
    topic.datatype = connection.datatype;
    topic.md5sum = connection.md5sum;
    ++topic.num_messages;
  }
  std::vector<BagTopic> topics;
  for (const auto& [name, topic] : by_name) topics.push_back(topic);
  return topics;
}

void DamagedBagFile::Rewind(const std::set<std::string>& topics, const ReceiptWindow& window) {
  wanted_ = topics;
  window_ = window;
  next_ = 0;
}

bool DamagedBagFile::Next(BagMessage* message) {
  for (; next_ < entries_.size(); ++next_) {
    const Entry& entry = entries_[next_];
    const Connection& connection = connections_.at(entry.connection);
    if (wanted_.count(connection.topic) == 0) continue;
    if (entry.receipt_ns < window_.begin_ns || entry.receipt_ns > window_.end_ns) continue;
    message->topic = connection.topic;
    message->datatype = connection.datatype;
    message->md5sum = connection.md5sum;
    message->receipt_ns = entry.receipt_ns;
    if (entry.chunk < 0) {
      if (!ReadBytes(entry.offset, entry.size, &message->bytes)) continue;
    } else {
      if (cached_chunk_ != entry.chunk) {
        cached_chunk_ = -1;
        if (!ReadContent(chunks_[static_cast<std::size_t>(entry.chunk)], &cached_content_)) {
          continue;
        }
        cached_chunk_ = entry.chunk;
      }
      const std::uint8_t* begin = cached_content_.data() + entry.offset;
      message->bytes.assign(begin, begin + entry.size);
    }
    ++next_;
    return true;
  }
  return false;
}

std::string DamagedBagFile::damage() const {
  std::string text = "has no usable index (the recording was cut off): read " +
                     std::to_string(entries_.size()) + " messages from " +
                     std::to_string(walked_bytes_) + " of " + std::to_string(file_size_) + " bytes";
  if (num_damaged_chunks_ > 0) {
    text += ", " + std::to_string(num_damaged_chunks_) + " damaged chunk(s) were lost";
  }
  if (walked_bytes_ < file_size_) {
    text += ", the last " + std::to_string(file_size_ - walked_bytes_) +
            " bytes are an incomplete record, of which only whole messages were used";
  }
  return text;
}

}  // namespace scenecalib
