#pragma once

#include <cassert>
#include <string>
#include <utility>
#include <variant>

namespace scenecalib {

/// Why an operation did not succeed. The message is for a person: one line that names the thing
/// (file, topic, key, camera) and, where there is one, the remedy.
class [[nodiscard]] Status {
 public:
  /// Kinds of failure a caller may want to tell apart.
  enum class Code {
    kOk,
    kInvalidArgument,   ///< a value outside its bound, an unknown key, a malformed file
    kNotFound,          ///< a missing file, topic or camera
    kInsufficientData,  ///< readable, but too little of it (no motion, no tracks, empty bag)
    kNumericalFailure,  ///< a solver diverged or a system was singular
    kCancelled,         ///< stopped on request
    kUnavailable,       ///< the environment refused (disk full, no permission)
  };

  Status() = default;
  Status(Code code, std::string message) : code_(code), message_(std::move(message)) {}

  static Status Ok() { return {}; }
  static Status InvalidArgument(std::string m) { return {Code::kInvalidArgument, std::move(m)}; }
  static Status NotFound(std::string m) { return {Code::kNotFound, std::move(m)}; }
  static Status InsufficientData(std::string m) { return {Code::kInsufficientData, std::move(m)}; }
  static Status NumericalFailure(std::string m) { return {Code::kNumericalFailure, std::move(m)}; }
  static Status Cancelled(std::string m) { return {Code::kCancelled, std::move(m)}; }
  static Status Unavailable(std::string m) { return {Code::kUnavailable, std::move(m)}; }

  bool ok() const { return code_ == Code::kOk; }
  Code code() const { return code_; }
  const std::string& message() const { return message_; }

 private:
  Code code_ = Code::kOk;
  std::string message_;
};

/// A value, or the Status that says why there is none.
template <typename T>
class [[nodiscard]] Result {
 public:
  Result(T value) : content_(std::in_place_index<0>, std::move(value)) {}        // NOLINT: implicit
  Result(Status status) : content_(std::in_place_index<1>, std::move(status)) {  // NOLINT
    assert(!std::get<1>(content_).ok() && "a Result without a value needs an error status");
  }

  bool ok() const { return content_.index() == 0; }
  explicit operator bool() const { return ok(); }

  /// The error, or Ok when there is a value.
  Status status() const { return ok() ? Status::Ok() : std::get<1>(content_); }

  /// The value; only when ok().
  const T& value() const& {
    assert(ok());
    return std::get<0>(content_);
  }
  T& value() & {
    assert(ok());
    return std::get<0>(content_);
  }
  T&& value() && {
    assert(ok());
    return std::move(std::get<0>(content_));
  }
  const T& operator*() const& { return value(); }
  T& operator*() & { return value(); }
  const T* operator->() const { return &value(); }
  T* operator->() { return &value(); }

 private:
  std::variant<T, Status> content_;
};

}  // namespace scenecalib

/// Returns the status from the enclosing function unless it is ok.
#define SCENECALIB_RETURN_IF_ERROR(expression)                    \
  do {                                                            \
    const ::scenecalib::Status scenecalib_status_ = (expression); \
    if (!scenecalib_status_.ok()) return scenecalib_status_;      \
  } while (false)
