#pragma once

#include <yaml-cpp/yaml.h>

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/base/status.h"

namespace scenecalib {

/// One place in a YAML file, read strictly. The first thing that is wrong anywhere in the document
/// is kept in the document's status, naming file, dotted key, value and bound; from then on every
/// reader returns empty values, so a parser reads straight on and checks the status once.
class YamlReader {
 public:
  /// What all readers of one file share; must outlive them.
  struct Document {
    std::string file;
    Status status;
  };

  /// The file's root: a map, or nothing in an empty file.
  static YamlReader Parse(const std::string& text, Document* document);

  /// An error unless this is a map whose keys are all among `known`, each given once.
  void CheckKeys(const std::vector<std::string>& known) const;
  /// The keys and values of a map, in the file's order.
  std::vector<std::pair<std::string, YamlReader>> Entries() const;
  bool Has(const std::string& key) const;
  /// The value of a key; an error when there is none.
  YamlReader Child(const std::string& key) const;
  std::optional<YamlReader> OptionalChild(const std::string& key) const;

  std::string String() const;  ///< not empty
  bool Boolean() const;
  int Integer(OptionBound bound = {}) const;
  double Number(OptionBound bound = {}) const;
  /// As Number, but .nan and .inf are numbers too.
  double AnyNumber() const;
  /// Exactly `count` numbers.
  std::vector<double> Numbers(std::size_t count, OptionBound bound = {}) const;
  std::vector<double> AnyNumbers(std::size_t count) const;
  /// A list of texts, possibly empty.
  std::vector<std::string> Strings() const;

  bool IsEmpty() const { return !node_.IsDefined() || node_.IsNull(); }
  const std::string& key() const { return key_; }
  const Status& status() const { return document_->status; }
  /// "FILE: KEY is VALUE, must be <what>".
  void FailValue(const std::string& must_be) const;
  /// "FILE: KEY<message>".
  void Fail(const std::string& message) const;

 private:
  YamlReader(YAML::Node node, std::string key, Document* document)
      : node_(std::move(node)), key_(std::move(key)), document_(document) {}
  YamlReader At(const YAML::Node& node, const std::string& name) const;
  bool failed() const { return !document_->status.ok(); }
  /// The items of a list that must have `count` of them; none after an error.
  std::vector<YamlReader> Items(std::size_t count, const std::string& of_what) const;
  /// An unquoted scalar: in YAML a quoted one is text.
  bool IsPlain() const;

  YAML::Node node_;
  std::string key_;
  Document* document_;
};

/// The shortest decimal that reads back as the same number.
std::string FormatNumber(double value);
/// "[low, high]".
std::string FormatBound(const OptionBound& bound);

}  // namespace scenecalib
