#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <string>
#include <vector>

namespace scenecalib {
namespace {

namespace fs = std::filesystem;

/// What each folder may include of the others (ARCHITECTURE's table, spelt out).
const std::map<std::string, std::set<std::string>>& Allowed() {
  static const std::set<std::string> kSensor = {"base", "geometry", "sensor"};
  static const auto kAllowed = [] {
    std::map<std::string, std::set<std::string>> allowed;
    const auto extend = [](std::set<std::string> set, const std::set<std::string>& more) {
      set.insert(more.begin(), more.end());
      return set;
    };
    allowed["base"] = {"base"};
    allowed["geometry"] = {"base", "geometry"};
    allowed["sensor"] = kSensor;
    allowed["mapping"] = extend(kSensor, {"mapping"});
    allowed["tracking"] = extend(kSensor, {"tracking"});
    allowed["segment"] = extend(kSensor, {"mapping", "tracking", "segment"});
    allowed["association"] = extend(kSensor, {"mapping", "tracking", "association"});
    allowed["calibration"] = extend(allowed["association"], {"calibration"});
    allowed["evaluation"] = extend(allowed["calibration"], {"evaluation"});
    // io reads and writes the types of every stage below it.
    allowed["io"] = extend(allowed["evaluation"], {"segment", "io"});
    allowed["simulation"] = extend(kSensor, {"io", "simulation"});
    allowed["pipeline"] = extend(allowed["io"], {"pipeline"});
    return allowed;
  }();
  return kAllowed;
}

std::vector<std::string> Includes(const fs::path& file) {
  static const std::regex kInclude(R"(^\s*#\s*include\s*[<"]([^>"]+)[>"])");
  std::vector<std::string> includes;
  std::ifstream stream(file);
  std::string line;
  std::smatch match;
  while (std::getline(stream, line)) {
    if (std::regex_search(line, match, kInclude)) includes.push_back(match[1]);
  }
  return includes;
}

/// ROS headers, and headers of any ROS message, service or package of ours.
bool IsRosHeader(const std::string& include) {
  static const std::regex kRos(
      R"(^(ros|rosbag|roslib|rosconsole|roslz4|tf|tf2|tf2_\w+|cv_bridge|image_transport|nodelet|)"
      R"(pluginlib|diagnostic_updater|message_filters|pcl_ros|pcl_conversions|\w+_msgs|\w+_srvs)/)");
  static const std::regex kGenerated(R"(^scenecalib/[A-Z]\w*\.h$)");
  return std::regex_search(include, kRos) || std::regex_search(include, kGenerated);
}

struct SourceFile {
  fs::path path;
  std::string folder;
};

std::vector<SourceFile> SourceFiles() {
  std::vector<SourceFile> files;
  const fs::path root = SCENECALIB_SOURCE_DIR;
  for (const fs::path& base : {root / "include" / "scenecalib", root / "src", root / "test"}) {
    for (const auto& entry : fs::recursive_directory_iterator(base)) {
      const std::string extension = entry.path().extension().string();
      if (extension != ".h" && extension != ".cc") continue;
      files.push_back({entry.path(), fs::relative(entry.path(), base).begin()->string()});
    }
  }
  return files;
}

bool MayUseRos(const std::string& folder) {
  return folder == "ros" || folder == "nodes" || folder == "rostest";
}

TEST(DependencyRule, RecognisesRosHeaders) {
  for (const char* header : {"ros/ros.h", "tf2_ros/buffer.h", "rosbag/bag.h", "sensor_msgs/Imu.h",
                             "std_srvs/Trigger.h", "scenecalib/Calibration.h"}) {
    EXPECT_TRUE(IsRosHeader(header)) << header;
  }
  for (const char* header :
       {"vector", "Eigen/Core", "scenecalib/sensor/rig.h", "opencv2/core.hpp"}) {
    EXPECT_FALSE(IsRosHeader(header)) << header;
  }
}

TEST(DependencyRule, NoRosOutsideTheRosLayer) {
  const std::vector<SourceFile> files = SourceFiles();
  ASSERT_GT(files.size(), 20U);
  for (const SourceFile& file : files) {
    if (MayUseRos(file.folder)) continue;
    for (const std::string& include : Includes(file.path)) {
      EXPECT_FALSE(IsRosHeader(include)) << file.path << " includes " << include;
    }
  }
}

TEST(DependencyRule, DependenciesGoUpTheTableOnly) {
  static const std::regex kOwn(R"(^scenecalib/(\w+)/)");
  for (const SourceFile& file : SourceFiles()) {
    const auto allowed = Allowed().find(file.folder);
    const bool is_test = file.path.string().find("_test.cc") != std::string::npos;
    if (allowed == Allowed().end() || is_test) continue;
    for (const std::string& include : Includes(file.path)) {
      std::smatch match;
      if (!std::regex_search(include, match, kOwn)) continue;
      EXPECT_EQ(allowed->second.count(match[1]), 1U) << file.path << " includes " << include;
    }
  }
}

TEST(DependencyRule, NodesAreThin) {
  for (const SourceFile& file : SourceFiles()) {
    if (file.folder != "nodes") continue;
    std::ifstream stream(file.path);
    std::string line;
    int num_lines = 0;
    while (std::getline(stream, line)) ++num_lines;
    EXPECT_LE(num_lines, 40) << file.path;
  }
}

}  // namespace
}  // namespace scenecalib
