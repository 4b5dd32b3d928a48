#include "scenecalib/base/log.h"

#include <mutex>
#include <utility>

namespace scenecalib {
namespace {

struct SinkHolder {
  std::mutex mutex;
  LogSink sink;
};

SinkHolder& Holder() {
  static SinkHolder* holder = new SinkHolder;  // never destroyed: usable during shutdown
  return *holder;
}

}  // namespace

LogSink SetLogSink(LogSink sink) {
  const std::lock_guard<std::mutex> lock(Holder().mutex);
  std::swap(sink, Holder().sink);
  return sink;
}

void Log(LogSeverity severity, const std::string& message) {
  LogSink sink;
  {
    const std::lock_guard<std::mutex> lock(Holder().mutex);
    sink = Holder().sink;
  }
  if (sink) sink(severity, message);
}

}  // namespace scenecalib
