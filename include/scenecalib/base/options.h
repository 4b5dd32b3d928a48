#pragma once

#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include "scenecalib/base/status.h"

namespace scenecalib {

/// Closed interval that a numeric option must lie in.
struct OptionBound {
  double min = -std::numeric_limits<double>::infinity();
  double max = std::numeric_limits<double>::infinity();
};

/// Visits the fields of an options struct. Every struct declares each field exactly once:
///
///   struct VoxelOptions {
///     double voxel_size_m = 0.5;
///     int max_points = 20;
///     void Visit(OptionVisitor& v) {
///       v.Field("voxel_size_m", &voxel_size_m, {0.05, 5.0}, "edge of a voxel of the local map");
///       v.Field("max_points", &max_points, {1, 100}, "points kept per voxel");
///     }
///   };
///   struct MapperOptions {
///     VoxelOptions voxels;
///     void Visit(OptionVisitor& v) { v.Group("voxels", &voxels); }
///   };
///
/// The same declaration reads a YAML file (io/options_yaml.h), checks bounds (CheckOptions), prints
/// the effective values (DescribeOptions) and documents them.
class OptionVisitor {
 public:
  virtual ~OptionVisitor() = default;
  virtual void Field(const char* name, double* value, OptionBound bound, const char* comment) = 0;
  virtual void Field(const char* name, int* value, OptionBound bound, const char* comment) = 0;
  virtual void Field(const char* name, bool* value, const char* comment) = 0;
  virtual void Field(const char* name, std::string* value, const char* comment) = 0;

  template <typename Options>
  void Group(const char* name, Options* options) {
    BeginGroup(name);
    options->Visit(*this);
    EndGroup();
  }

 protected:
  virtual void BeginGroup(const char* name) = 0;
  virtual void EndGroup() = 0;
};

/// One declared field with its effective value.
struct OptionDescription {
  std::string key;  ///< dotted path, "odometry.voxel_size_m"
  std::string value;
  std::string type;  ///< "double", "int", "bool" or "string"
  OptionBound bound;
  std::string comment;
  bool in_bound = true;
};

namespace internal {

/// Collects a description of every field.
class OptionDescriber : public OptionVisitor {
 public:
  void Field(const char* name, double* value, OptionBound bound, const char* comment) override;
  void Field(const char* name, int* value, OptionBound bound, const char* comment) override;
  void Field(const char* name, bool* value, const char* comment) override;
  void Field(const char* name, std::string* value, const char* comment) override;
  std::vector<OptionDescription> descriptions;

 protected:
  void BeginGroup(const char* name) override;
  void EndGroup() override;

 private:
  std::string Key(const char* name) const;
  std::vector<std::string> groups_;
};

Status CheckDescriptions(const std::vector<OptionDescription>& descriptions);

}  // namespace internal

/// Every field of the struct with its effective value, in declaration order.
template <typename Options>
std::vector<OptionDescription> DescribeOptions(Options options) {
  internal::OptionDescriber describer;
  options.Visit(describer);
  return std::move(describer.descriptions);
}

/// InvalidArgument naming key, value and bound of the first field that is out of range.
template <typename Options>
Status CheckOptions(const Options& options) {
  return internal::CheckDescriptions(DescribeOptions(options));
}

}  // namespace scenecalib
