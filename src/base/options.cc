#include "scenecalib/base/options.h"

#include <cmath>
#include <sstream>

namespace scenecalib {
namespace internal {
namespace {

template <typename T>
std::string Text(const T& value) {
  std::ostringstream stream;
  stream << value;
  return stream.str();
}

bool InBound(double value, const OptionBound& bound) {
  return !std::isnan(value) && value >= bound.min && value <= bound.max;
}

}  // namespace

std::string OptionDescriber::Key(const char* name) const {
  std::string key;
  for (const std::string& group : groups_) key += group + ".";
  return key + name;
}

void OptionDescriber::Field(const char* name, double* value, OptionBound bound,
                            const char* comment) {
  descriptions.push_back(
      {Key(name), Text(*value), "double", bound, comment, InBound(*value, bound)});
}

void OptionDescriber::Field(const char* name, int* value, OptionBound bound, const char* comment) {
  descriptions.push_back({Key(name), Text(*value), "int", bound, comment, InBound(*value, bound)});
}

void OptionDescriber::Field(const char* name, bool* value, const char* comment) {
  descriptions.push_back({Key(name), *value ? "true" : "false", "bool", {}, comment, true});
}

void OptionDescriber::Field(const char* name, std::string* value, const char* comment) {
  descriptions.push_back({Key(name), *value, "string", {}, comment, true});
}

void OptionDescriber::BeginGroup(const char* name) { groups_.emplace_back(name); }
void OptionDescriber::EndGroup() { groups_.pop_back(); }

Status CheckDescriptions(const std::vector<OptionDescription>& descriptions) {
  for (const OptionDescription& d : descriptions) {
    if (d.in_bound) continue;
    return Status::InvalidArgument("option " + d.key + " is " + d.value + ", must be in [" +
                                   Text(d.bound.min) + ", " + Text(d.bound.max) + "]");
  }
  return Status::Ok();
}

}  // namespace internal
}  // namespace scenecalib
