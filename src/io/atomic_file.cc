#include "scenecalib/io/atomic_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>

namespace scenecalib {
namespace {

Status Failure(const std::string& path, const char* what) {
  return Status::Unavailable(path + ": cannot be " + what + ": " + std::strerror(errno));
}

/// Writes and flushes; closes the descriptor in any case.
Status WriteAndClose(int descriptor, const std::string& content, const std::string& path) {
  Status status;
  std::size_t written = 0;
  while (written < content.size()) {
    const ssize_t n = ::write(descriptor, content.data() + written, content.size() - written);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) {
      status = Failure(path, "written");
      break;
    }
    written += static_cast<std::size_t>(n);
  }
  if (status.ok() && ::fsync(descriptor) != 0) status = Failure(path, "flushed");
  if (::close(descriptor) != 0 && status.ok()) status = Failure(path, "closed");
  return status;
}

}  // namespace

Status WriteFileAtomically(const std::string& path, const std::string& content) {
  // Beside the target, because a rename is atomic only within one file system. O_EXCL, because two
  // processes, or threads, must not write the same temporary file.
  constexpr int kMaxAttempts = 100;
  std::string temporary;
  int descriptor = -1;
  for (int attempt = 0; descriptor < 0 && attempt < kMaxAttempts; ++attempt) {
    temporary = path + ".tmp." + std::to_string(::getpid()) + "." + std::to_string(attempt);
    descriptor = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (descriptor < 0 && errno != EEXIST) break;
  }
  if (descriptor < 0) return Failure(path, "created");
  Status status = WriteAndClose(descriptor, content, path);
  if (status.ok() && std::rename(temporary.c_str(), path.c_str()) != 0) {
    status = Failure(path, "replaced");
  }
  if (!status.ok()) {
    ::unlink(temporary.c_str());
    return status;
  }
  // The rename itself survives a power cut only when the folder is flushed; some file systems
  // cannot do that, and the file is complete either way.
  const std::size_t slash = path.rfind('/');
  const std::string folder = slash == std::string::npos ? "." : path.substr(0, slash + 1);
  const int folder_descriptor = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder_descriptor >= 0) {
    ::fsync(folder_descriptor);
    ::close(folder_descriptor);
  }
  return Status::Ok();
}

}  // namespace scenecalib
