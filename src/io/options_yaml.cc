#include "scenecalib/io/options_yaml.h"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>
#include <vector>

#include "yaml_reader.h"

namespace scenecalib {
namespace internal {
namespace {

/// Reads the fields of one struct from the map at the same place in the file.
class YamlOptionVisitor : public OptionVisitor {
 public:
  explicit YamlOptionVisitor(const YamlReader& root) { levels_.push_back({root, {}}); }

  void Field(const char* name, double* value, OptionBound bound, const char*) override {
    if (const auto child = Declare(name)) *value = child->Number(bound);
  }
  void Field(const char* name, int* value, OptionBound bound, const char*) override {
    if (const auto child = Declare(name)) *value = child->Integer(bound);
  }
  void Field(const char* name, bool* value, const char*) override {
    if (const auto child = Declare(name)) *value = child->Boolean();
  }
  void Field(const char* name, std::string* value, const char*) override {
    if (const auto child = Declare(name)) *value = child->String();
  }

  void CheckUnknownKeys() const {
    if (levels_.back().reader) levels_.back().reader->CheckKeys(levels_.back().declared);
  }

 protected:
  void BeginGroup(const char* name) override { levels_.push_back({Declare(name), {}}); }
  void EndGroup() override {
    CheckUnknownKeys();
    levels_.pop_back();
  }

 private:
  struct Level {
    std::optional<YamlReader> reader;  ///< none when the file does not mention the group
    std::vector<std::string> declared;
  };

  std::optional<YamlReader> Declare(const char* name) {
    Level& level = levels_.back();
    level.declared.emplace_back(name);
    return level.reader ? level.reader->OptionalChild(name) : std::nullopt;
  }

  std::vector<Level> levels_;
};

}  // namespace

Status ApplyOptionsYaml(const std::string& yaml_text, const std::string& source_name,
                        const std::function<void(OptionVisitor&)>& visit) {
  YamlReader::Document document{source_name, Status::Ok()};
  const YamlReader root = YamlReader::Parse(yaml_text, &document);
  if (!document.status.ok() || root.IsEmpty()) return document.status;
  YamlOptionVisitor visitor(root);
  visit(visitor);
  visitor.CheckUnknownKeys();
  return document.status;
}

Result<std::string> ReadTextFile(const std::string& path) {
  errno = 0;
  std::ifstream file(path, std::ios::binary);
  if (!file) return Status::NotFound(path + ": cannot be opened: " + std::strerror(errno));
  std::ostringstream text;
  text << file.rdbuf();
  if (file.bad() || text.fail()) {
    // An empty file sets failbit as well; a directory opens but cannot be read.
    file.clear();
    if (file.peek() != std::ifstream::traits_type::eof() || file.bad()) {
      return Status::Unavailable(path + ": cannot be read: " + std::strerror(errno));
    }
  }
  return text.str();
}

}  // namespace internal
}  // namespace scenecalib
