#pragma once

#include <string>

#include "scenecalib/base/status.h"

namespace scenecalib {

/// Writes a temporary file beside `path`, flushes it to the disk and renames it to `path`: a reader
/// sees the old content or the new one, never half of it, and a failure leaves the old file as it
/// was. Unavailable, naming the file and the system's reason, when that is not possible.
Status WriteFileAtomically(const std::string& path, const std::string& content);

}  // namespace scenecalib
