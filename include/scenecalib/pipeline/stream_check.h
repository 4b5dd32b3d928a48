#pragma once

#include <string>
#include <utility>

#include "scenecalib/base/status.h"
#include "scenecalib/base/timestamp.h"
#include "scenecalib/pipeline/pipeline_options.h"

namespace scenecalib {

/// Watches the stamps of one sensor's messages and counts what was refused of them.
class StreamCheck {
 public:
  /// `name` stands for the sensor in messages: "lidar (/lidar/points)".
  explicit StreamCheck(std::string name) : name_(std::move(name)) {}

  /// Notes a message's stamp. InvalidArgument when it does not increase: skip the message.
  Status Note(Timestamp stamp_ns);
  /// Notes that a message whose stamp was noted was refused for another reason.
  void NoteRejected(const std::string& reason);
  /// Notes a message that could not be decoded, so that it has no stamp.
  void NoteUndecoded(const std::string& reason);

  /// Whether the stream as a whole can be used: InsufficientData when it is empty, InvalidArgument
  /// when too many stamps ran backwards or, if `check_gaps`, jumped too far.
  Status Check(const StreamCheckOptions& options, bool check_gaps) const;

  /// One line about what was skipped; empty when nothing was.
  std::string Warning() const;

  int num_messages() const { return num_messages_; }
  int num_used() const { return num_messages_ - num_backwards_ - num_rejected_; }
  Timestamp first_ns() const { return first_ns_; }
  Timestamp last_ns() const { return last_ns_; }

 private:
  std::string name_;
  bool has_stamp_ = false;
  int num_messages_ = 0;
  int num_backwards_ = 0;
  int num_rejected_ = 0;
  double largest_step_back_s_ = 0.0;
  double largest_gap_s_ = 0.0;
  Timestamp largest_gap_at_ns_ = 0;
  Timestamp first_ns_ = 0;
  Timestamp last_ns_ = 0;
  std::string first_rejection_;
};

}  // namespace scenecalib
