#pragma once

#include <functional>
#include <string>

#include "scenecalib/base/options.h"

namespace scenecalib {

namespace internal {
/// Applies one YAML document to the fields that `visit` declares.
Status ApplyOptionsYaml(const std::string& yaml_text, const std::string& source_name,
                        const std::function<void(OptionVisitor&)>& visit);
Result<std::string> ReadTextFile(const std::string& path);
}  // namespace internal

/// Overwrites the fields that the YAML file names (nested maps as the groups), leaves the others.
/// InvalidArgument naming file, key, value and bound for an unknown, mistyped or out-of-range key;
/// `options` is then unchanged.
template <typename Options>
Status ReadOptionsYaml(const std::string& path, Options* options) {
  const Result<std::string> text = internal::ReadTextFile(path);
  if (!text.ok()) return text.status();
  Options changed = *options;
  SCENECALIB_RETURN_IF_ERROR(internal::ApplyOptionsYaml(
      *text, path, [&changed](OptionVisitor& visitor) { changed.Visit(visitor); }));
  *options = changed;
  return Status::Ok();
}

}  // namespace scenecalib
