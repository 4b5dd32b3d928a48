#include "scenecalib/evaluation/rate_table.h"

#include <cstdio>

#include "scenecalib/evaluation/miscalibration_rate.h"

namespace scenecalib {
namespace {

std::string Line(const std::string& first, const std::string& second,
                 const MiscalibrationRate& rate) {
  char text[256];
  std::snprintf(text, sizeof(text), "%-20s %-28s %5.3f  %5.3f  %5.3f  %5.3f  %5.3f  %5.3f\n",
                first.c_str(), second.c_str(), rate.x, rate.y, rate.z, rate.roll, rate.pitch,
                rate.yaw);
  return text;
}

/// Mean over the cameras of one class that have a rate.
std::optional<MiscalibrationRate> Mean(const std::vector<CameraConfig>& cameras,
                                       const RatedRig& rig, FieldOfView field_of_view) {
  MiscalibrationRate sum;
  double count = 0.0;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    if (!rig.rates[i] || !cameras[i].model || FieldOfViewOf(*cameras[i].model) != field_of_view) {
      continue;
    }
    const MiscalibrationRate& rate = *rig.rates[i];
    sum.x += rate.x;
    sum.y += rate.y;
    sum.z += rate.z;
    sum.roll += rate.roll;
    sum.pitch += rate.pitch;
    sum.yaw += rate.yaw;
    count += 1.0;
  }
  if (count == 0.0) return std::nullopt;
  return MiscalibrationRate{sum.x / count,    sum.y / count,     sum.z / count,
                            sum.roll / count, sum.pitch / count, sum.yaw / count};
}

}  // namespace

std::string FormatRateTable(const std::vector<CameraConfig>& cameras,
                            const std::vector<RatedRig>& rigs) {
  char header[256];
  std::snprintf(header, sizeof(header), "%-20s %-28s %5s  %5s  %5s  %5s  %5s  %5s\n", "camera",
                "rig", "x", "y", "z", "roll", "pitch", "yaw");
  std::string text = header;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    for (const RatedRig& rig : rigs) {
      text += rig.rates[i] ? Line(cameras[i].name, rig.name, *rig.rates[i])
                           : cameras[i].name + ": " + rig.name + ": too few shared points\n";
    }
  }
  for (int k = 0; k < kNumFieldsOfView; ++k) {
    const auto field_of_view = static_cast<FieldOfView>(k);
    bool any = false;
    for (const RatedRig& rig : rigs) {
      const auto mean = Mean(cameras, rig, field_of_view);
      if (!mean) continue;
      any = true;
      text += Line(ToString(field_of_view), rig.name, *mean);
    }
    if (any) text += Line(ToString(field_of_view), "published", PublishedRate(field_of_view));
  }
  return text;
}

std::string FormatRateYaml(const std::vector<CameraConfig>& cameras,
                           const std::vector<RatedRig>& rigs) {
  std::string text = "miscalibration_rates:\n";
  for (const RatedRig& rig : rigs) {
    text += "  - rig: \"";
    for (const char c : rig.name)
      text += c == '"' || c == '\\' ? std::string("\\") + c : std::string(1, c);
    text += "\"\n    cameras:\n";
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      text += "      " + cameras[i].name + ": ";
      if (!rig.rates[i]) {
        text += "null\n";
        continue;
      }
      const MiscalibrationRate& r = *rig.rates[i];
      char line[256];
      std::snprintf(line, sizeof(line),
                    "{x: %.4f, y: %.4f, z: %.4f, roll: %.4f, pitch: %.4f, yaw: %.4f}\n", r.x, r.y,
                    r.z, r.roll, r.pitch, r.yaw);
      text += line;
    }
  }
  return text;
}

}  // namespace scenecalib
