#include "yaml_reader.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <locale>
#include <set>
#include <sstream>

namespace scenecalib {
namespace {

/// What the file says there, for messages.
std::string ShowValue(const YAML::Node& node) {
  constexpr std::size_t kMaxShown = 80;
  if (!node.IsDefined() || node.IsNull()) return "empty";
  if (node.IsScalar()) {
    const std::string& text = node.Scalar();
    return "'" + (text.size() > kMaxShown ? text.substr(0, kMaxShown) + "..." : text) + "'";
  }
  if (node.IsMap()) return "a map";
  return "a list of " + std::to_string(node.size());
}

bool ParseDouble(const std::string& text, double* value) {
  std::istringstream stream(text);
  stream.imbue(std::locale::classic());
  stream >> *value;
  return !stream.fail() && stream.peek() == std::istringstream::traits_type::eof();
}

std::string Join(const std::vector<std::string>& words) {
  std::string joined;
  for (const std::string& word : words) joined += (joined.empty() ? "" : ", ") + word;
  return joined;
}

std::string NumberIn(const char* what, const OptionBound& bound) {
  const bool bounded = std::isfinite(bound.min) || std::isfinite(bound.max);
  return std::string(what) + (bounded ? " in " + FormatBound(bound) : "");
}

}  // namespace

std::string FormatNumber(double value) {
  if (std::isnan(value)) return ".nan";
  if (std::isinf(value)) return value > 0.0 ? ".inf" : "-.inf";
  for (int digits = 6;; ++digits) {
    std::ostringstream stream;
    stream.imbue(std::locale::classic());
    stream.precision(digits);
    stream << value;
    double back = 0.0;
    if (digits >= 17 || (ParseDouble(stream.str(), &back) && back == value)) return stream.str();
  }
}

std::string FormatBound(const OptionBound& bound) {
  return "[" + FormatNumber(bound.min) + ", " + FormatNumber(bound.max) + "]";
}

YamlReader YamlReader::Parse(const std::string& text, Document* document) {
  YAML::Node root(YAML::NodeType::Undefined);
  try {
    root = YAML::Load(text);
  } catch (const YAML::Exception& error) {
    std::ostringstream message;
    message << document->file << ": not valid YAML: line " << error.mark.line + 1 << ", column "
            << error.mark.column + 1 << ": " << error.msg;
    document->status = Status::InvalidArgument(message.str());
  }
  return {root, "", document};
}

void YamlReader::Fail(const std::string& message) const {
  if (failed()) return;
  const std::string place = key_.empty() ? "the file" : key_;
  document_->status = Status::InvalidArgument(document_->file + ": " + place + message);
}

void YamlReader::FailValue(const std::string& must_be) const {
  Fail(" is " + ShowValue(node_) + ", must be " + must_be);
}

YamlReader YamlReader::At(const YAML::Node& node, const std::string& name) const {
  return {node, key_.empty() ? name : key_ + "." + name, document_};
}

std::vector<std::pair<std::string, YamlReader>> YamlReader::Entries() const {
  std::vector<std::pair<std::string, YamlReader>> entries;
  if (failed()) return entries;
  if (!node_.IsDefined() || !node_.IsMap()) {
    FailValue("a map");
    return entries;
  }
  std::set<std::string> names;
  for (const auto& entry : node_) {
    if (!entry.first.IsScalar()) {
      Fail(" has a key that is " + ShowValue(entry.first) + ", must be a name");
      return {};
    }
    const std::string& name = entry.first.Scalar();
    const YamlReader child = At(entry.second, name);
    if (!names.insert(name).second) {
      child.Fail(" is given twice");
      return {};
    }
    entries.emplace_back(name, child);
  }
  return entries;
}

void YamlReader::CheckKeys(const std::vector<std::string>& known) const {
  for (const auto& [name, child] : Entries()) {
    if (std::find(known.begin(), known.end(), name) != known.end()) continue;
    child.Fail(" is an unknown key (its value is " + ShowValue(child.node_) +
               "); known here: " + Join(known));
  }
}

bool YamlReader::Has(const std::string& key) const {
  return !failed() && node_.IsDefined() && node_.IsMap() && node_[key].IsDefined();
}

std::optional<YamlReader> YamlReader::OptionalChild(const std::string& key) const {
  if (!Has(key)) return std::nullopt;
  return At(node_[key], key);
}

YamlReader YamlReader::Child(const std::string& key) const {
  if (Has(key)) return At(node_[key], key);
  const YamlReader missing = At(YAML::Node(YAML::NodeType::Undefined), key);
  missing.Fail(" is missing");
  return missing;
}

bool YamlReader::IsPlain() const {
  return node_.IsDefined() && node_.IsScalar() && node_.Tag() != "!";
}

std::string YamlReader::String() const {
  if (failed()) return {};
  if (node_.IsDefined() && node_.IsScalar() && !node_.Scalar().empty()) return node_.Scalar();
  FailValue("a text");
  return {};
}

bool YamlReader::Boolean() const {
  if (failed()) return false;
  const std::string text = IsPlain() ? node_.Scalar() : "";
  if (text == "true" || text == "True") return true;
  if (text != "false" && text != "False") FailValue("true or false");
  return false;
}

int YamlReader::Integer(OptionBound bound) const {
  if (failed()) return 0;
  const std::string text = IsPlain() ? node_.Scalar() : "";
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (!text.empty() && error == std::errc() && end == text.data() + text.size() &&
      value >= bound.min && value <= bound.max) {
    return value;
  }
  FailValue(NumberIn("an integer", bound));
  return 0;
}

double YamlReader::Number(OptionBound bound) const {
  if (failed()) return 0.0;
  double value = 0.0;
  if (IsPlain() && ParseDouble(node_.Scalar(), &value) && std::isfinite(value) &&
      value >= bound.min && value <= bound.max) {
    return value;
  }
  FailValue(NumberIn("a number", bound));
  return 0.0;
}

double YamlReader::AnyNumber() const {
  if (failed()) return 0.0;
  const std::string text = IsPlain() ? node_.Scalar() : "";
  if (text == ".nan") return std::nan("");
  if (text == ".inf") return std::numeric_limits<double>::infinity();
  if (text == "-.inf") return -std::numeric_limits<double>::infinity();
  return Number();
}

std::vector<YamlReader> YamlReader::Items(std::size_t count, const std::string& of_what) const {
  std::vector<YamlReader> items;
  if (failed()) return items;
  if (!node_.IsDefined() || !node_.IsSequence() || node_.size() != count) {
    FailValue("a list of " + std::to_string(count) + " " + of_what);
    return items;
  }
  for (std::size_t i = 0; i < count; ++i) {
    items.push_back({node_[i], key_ + "[" + std::to_string(i) + "]", document_});
  }
  return items;
}

std::vector<double> YamlReader::Numbers(std::size_t count, OptionBound bound) const {
  std::vector<double> values;
  for (const YamlReader& item : Items(count, "numbers")) values.push_back(item.Number(bound));
  values.resize(count, 0.0);  // after an error
  return values;
}

std::vector<double> YamlReader::AnyNumbers(std::size_t count) const {
  std::vector<double> values;
  for (const YamlReader& item : Items(count, "numbers")) values.push_back(item.AnyNumber());
  values.resize(count, 0.0);  // after an error
  return values;
}

std::vector<std::string> YamlReader::Strings() const {
  std::vector<std::string> values;
  if (failed()) return values;
  if (!node_.IsDefined() || !node_.IsSequence()) {
    FailValue("a list of texts");
    return values;
  }
  for (const YamlReader& item : Items(node_.size(), "texts")) values.push_back(item.String());
  return values;
}

}  // namespace scenecalib
