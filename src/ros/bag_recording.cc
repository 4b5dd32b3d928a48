#include "scenecalib/ros/bag_recording.h"

#include <ros/serialization.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>

#include <algorithm>
#include <exception>
#include <fstream>
#include <map>
#include <utility>

#include "scenecalib/ros/damaged_bag_file.h"

namespace scenecalib {
namespace {

/// A bag with its index, read by rosbag.
class IndexedBagFile : public BagFile {
 public:
  /// Throws rosbag::BagException (or std::exception) when rosbag cannot read the file.
  explicit IndexedBagFile(const std::string& path) {
    bag_.open(path, rosbag::bagmode::Read);
    rosbag::View view(bag_);
    if (view.size() == 0) return;
    begin_ns_ = static_cast<Timestamp>(view.getBeginTime().toNSec());
    end_ns_ = static_cast<Timestamp>(view.getEndTime().toNSec());
    std::map<std::string, BagTopic> by_name;
    for (const rosbag::ConnectionInfo* connection : view.getConnections()) {
      BagTopic& topic = by_name[connection->topic];
      topic.name = connection->topic;
      topic.datatype = connection->datatype;
      topic.md5sum = connection->md5sum;
    }
    for (auto& [name, topic] : by_name) {
      rosbag::View of_topic(bag_, rosbag::TopicQuery(name));
      topic.num_messages = static_cast<int>(of_topic.size());
      topics_.push_back(topic);
    }
  }

  std::vector<BagTopic> topics() const override { return topics_; }

  Timestamp begin_ns() const override { return begin_ns_; }
  Timestamp end_ns() const override { return end_ns_; }

  void Rewind(const std::set<std::string>& topics, const ReceiptWindow& window) override {
    const std::vector<std::string> names(topics.begin(), topics.end());
    view_ = std::make_unique<rosbag::View>(bag_, rosbag::TopicQuery(names), Time(window.begin_ns),
                                           Time(window.end_ns));
    next_ = view_->begin();
    num_unreadable_ = 0;
  }

  bool Next(BagMessage* message) override {
    while (view_ && next_ != view_->end()) {
      const rosbag::MessageInstance instance = *next_;
      ++next_;
      try {
        message->topic = instance.getTopic();
        message->datatype = instance.getDataType();
        message->md5sum = instance.getMD5Sum();
        message->receipt_ns = static_cast<Timestamp>(instance.getTime().toNSec());
        message->bytes.resize(instance.size());
        ros::serialization::OStream stream(message->bytes.data(),
                                           static_cast<std::uint32_t>(message->bytes.size()));
        instance.write(stream);
        return true;
      } catch (const std::exception&) {  // a damaged chunk in an otherwise intact file
        ++num_unreadable_;
      }
    }
    return false;
  }

  int num_unreadable() const override { return num_unreadable_; }

  std::string damage() const override {
    if (num_unreadable_ == 0) return {};
    return "has damaged chunks: " + std::to_string(num_unreadable_) +
           " message(s) could not be read and were left out";
  }

 private:
  /// Within what ros::Time can hold.
  static ros::Time Time(Timestamp stamp_ns) {
    ros::Time time;
    time.fromNSec(static_cast<std::uint64_t>(std::max<Timestamp>(1, stamp_ns)));
    return time;
  }

  rosbag::Bag bag_;
  std::unique_ptr<rosbag::View> view_;
  rosbag::View::iterator next_;
  std::vector<BagTopic> topics_;
  Timestamp begin_ns_ = 0;
  Timestamp end_ns_ = 0;
  int num_unreadable_ = 0;
};

}  // namespace

Result<std::unique_ptr<BagFile>> OpenBagFile(const std::string& path) {
  if (!std::ifstream(path, std::ios::binary)) {
    return Status::NotFound("bag " + path + " does not exist or cannot be read");
  }
  try {
    auto bag = std::make_unique<IndexedBagFile>(path);
    if (!bag->topics().empty()) return std::unique_ptr<BagFile>(std::move(bag));
    return Status::InsufficientData("bag " + path + " is empty: it holds no message");
  } catch (const std::exception&) {
    return DamagedBagFile::Open(path);  // which says what is wrong with it
  }
}

Result<BagRecording> BagRecording::Open(const std::vector<std::string>& paths) {
  if (paths.empty()) return Status::InvalidArgument("no bag is given");
  BagRecording recording;
  recording.paths_ = paths;
  for (const std::string& path : paths) {
    Result<std::unique_ptr<BagFile>> file = OpenBagFile(path);
    if (!file.ok()) return file.status();
    recording.files_.push_back(std::move(file).value());
  }
  return Result<BagRecording>(std::move(recording));
}

Timestamp BagRecording::begin_ns() const {
  Timestamp begin_ns = files_.front()->begin_ns();
  for (const auto& file : files_) begin_ns = std::min(begin_ns, file->begin_ns());
  return begin_ns;
}

Timestamp BagRecording::end_ns() const {
  Timestamp end_ns = files_.front()->end_ns();
  for (const auto& file : files_) end_ns = std::max(end_ns, file->end_ns());
  return end_ns;
}

std::vector<BagTopic> BagRecording::topics() const {
  std::map<std::string, BagTopic> by_name;
  for (const auto& file : files_) {
    for (const BagTopic& topic : file->topics()) {
      const auto [at, is_new] = by_name.emplace(topic.name, topic);
      if (!is_new) at->second.num_messages += topic.num_messages;
    }
  }
  std::vector<BagTopic> topics;
  for (const auto& [name, topic] : by_name) topics.push_back(topic);
  return topics;
}

std::string BagRecording::name() const {
  std::string name;
  for (const std::string& path : paths_) name += (name.empty() ? "" : ", ") + path;
  return name;
}

void BagRecording::ForEachMessage(const std::set<std::string>& topics,
                                  const std::function<bool(BagMessage&&)>& handle,
                                  const ReceiptWindow& window) {
  struct Head {
    BagMessage message;
    bool valid = false;
  };
  std::vector<Head> heads(files_.size());
  for (std::size_t i = 0; i < files_.size(); ++i) {
    files_[i]->Rewind(topics, window);
    heads[i].valid = files_[i]->Next(&heads[i].message);
  }
  while (true) {
    Head* first = nullptr;  // ties go to the file given first
    for (Head& head : heads) {
      if (head.valid && (!first || head.message.receipt_ns < first->message.receipt_ns)) {
        first = &head;
      }
    }
    if (!first || !handle(std::move(first->message))) return;
    first->message = BagMessage();
    first->valid = files_[static_cast<std::size_t>(first - heads.data())]->Next(&first->message);
  }
}

std::vector<std::string> BagRecording::damages() const {
  std::vector<std::string> lines;
  for (std::size_t i = 0; i < files_.size(); ++i) {
    const std::string damage = files_[i]->damage();
    if (!damage.empty()) lines.push_back("bag " + paths_[i] + " " + damage);
  }
  return lines;
}

}  // namespace scenecalib
