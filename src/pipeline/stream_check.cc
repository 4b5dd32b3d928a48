#include "scenecalib/pipeline/stream_check.h"

#include <algorithm>
#include <cstdio>

namespace scenecalib {
namespace {

std::string Seconds(double seconds) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.3f s", seconds);
  return text;
}

}  // namespace

Status StreamCheck::Note(Timestamp stamp_ns) {
  ++num_messages_;
  if (!has_stamp_) {
    has_stamp_ = true;
    first_ns_ = last_ns_ = stamp_ns;
    return Status::Ok();
  }
  const double step_s = SecondsBetween(last_ns_, stamp_ns);
  if (step_s <= 0.0) {
    ++num_backwards_;
    largest_step_back_s_ = std::max(largest_step_back_s_, -step_s);
    return Status::InvalidArgument(name_ + ": stamp runs backwards by " + Seconds(-step_s));
  }
  if (step_s > largest_gap_s_) {
    largest_gap_s_ = step_s;
    largest_gap_at_ns_ = last_ns_;
  }
  last_ns_ = stamp_ns;
  return Status::Ok();
}

void StreamCheck::NoteRejected(const std::string& reason) {
  if (num_rejected_++ == 0) first_rejection_ = reason;
}

void StreamCheck::NoteUndecoded(const std::string& reason) {
  ++num_messages_;
  NoteRejected(reason);
}

Status StreamCheck::Check(const StreamCheckOptions& options, bool check_gaps) const {
  if (num_messages_ == 0) return Status::InsufficientData(name_ + ": no message");
  if (num_backwards_ > options.max_backwards_share * num_messages_) {
    return Status::InvalidArgument(
        name_ + ": stamps run backwards " + std::to_string(num_backwards_) + " times in " +
        std::to_string(num_messages_) + " messages (by up to " + Seconds(largest_step_back_s_) +
        "): correct the recording's header stamps");
  }
  if (num_used() <= 0) {
    return Status::InsufficientData(name_ + ": none of " + std::to_string(num_messages_) +
                                    " messages can be used: " + first_rejection_);
  }
  if (check_gaps && largest_gap_s_ > options.max_stamp_gap_s) {
    return Status::InvalidArgument(name_ + ": stamps jump by " + Seconds(largest_gap_s_) + ", " +
                                   Seconds(SecondsBetween(first_ns_, largest_gap_at_ns_)) +
                                   " after the first: calibrate on one of the stretches (rosbag "
                                   "filter), or correct the stamps");
  }
  return Status::Ok();
}

std::string StreamCheck::Warning() const {
  std::string text;
  if (num_backwards_ > 0) {
    text = std::to_string(num_backwards_) + " messages skipped whose stamp ran backwards";
  }
  if (num_rejected_ > 0) {
    text += (text.empty() ? "" : "; ") + std::to_string(num_rejected_) +
            " messages skipped, the first because: " + first_rejection_;
  }
  return text.empty() ? text : name_ + ": " + text;
}

}  // namespace scenecalib
