#include "scenecalib/evaluation/result_table.h"

#include <algorithm>
#include <cstdio>
#include <vector>

#include "scenecalib/evaluation/rig_comparison.h"
#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kDegreesPerRadian = 180.0 / 3.14159265358979323846;

std::string Decimal(double value, int digits) {
  char text[64];
  std::snprintf(text, sizeof(text), "%.*f", digits, value);
  return text;
}

std::string BeforeAfter(double before, double after, int digits) {
  return Decimal(before, digits) + " -> " + Decimal(after, digits);
}

/// Pads every column to its widest cell: the first to the left, the others to the right.
std::string Align(const std::vector<std::vector<std::string>>& rows) {
  std::vector<std::size_t> widths;
  for (const auto& row : rows) {
    widths.resize(std::max(widths.size(), row.size()), 0);
    for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
  }
  std::string text;
  for (const auto& row : rows) {
    std::string line;
    for (std::size_t i = 0; i < row.size(); ++i) {
      const std::string padding(widths[i] - row[i].size(), ' ');
      line += i == 0 ? row[i] + padding : "  " + padding + row[i];
    }
    text += line.substr(0, line.find_last_not_of(' ') + 1) + "\n";
  }
  return text;
}

const CameraConfig* Find(const Rig& rig, const std::string& name) {
  for (const CameraConfig& camera : rig.cameras) {
    if (camera.name == name) return &camera;
  }
  return nullptr;
}

std::vector<std::string> ResultRow(const CameraConfig& camera, const CameraConfig* initial,
                                   const CameraQuality& quality) {
  std::vector<std::string> row = {
      camera.name, quality.accepted ? "yes" : "no",
      BeforeAfter(quality.rms_before_px, quality.rms_after_px, 3),
      std::to_string(quality.num_inlier_tracks) + " of " + std::to_string(quality.num_tracks),
      std::to_string(quality.num_cross_camera_matches)};
  if (initial == nullptr) {
    row.insert(row.end(), {"-", "-"});
  } else {
    const Rigid3 change = initial->lidar_from_camera.Inverse() * camera.lidar_from_camera;
    row.push_back(Decimal(LogSo3(change.rotation).norm() * kDegreesPerRadian, 3));
    row.push_back(Decimal(100.0 * change.translation.norm(), 1));
  }
  row.push_back(Decimal(quality.stddev.rotation_rad.norm() * kDegreesPerRadian, 3));
  row.push_back(Decimal(100.0 * quality.stddev.translation_m.norm(), 1));
  return row;
}

/// A rig of one camera, so that a camera that cannot be compared does not hide the others.
Rig Only(const CameraConfig& camera) {
  Rig rig;
  rig.cameras = {camera};
  return rig;
}

}  // namespace

std::string FormatResultTable(const Rig& initial, const CalibrationResult& result) {
  std::vector<std::vector<std::string>> rows = {{"camera", "accepted", "rms px", "tracks used",
                                                 "cross", "moved deg", "moved cm", "stddev deg",
                                                 "stddev cm"}};
  std::string reasons;
  for (const std::string& reason : result.reasons) reasons += reason + "\n";
  for (std::size_t i = 0; i < result.rig.cameras.size(); ++i) {
    const CameraConfig& camera = result.rig.cameras[i];
    rows.push_back(ResultRow(camera, Find(initial, camera.name), result.cameras.at(i)));
    for (const std::string& reason : result.cameras[i].reasons) {
      reasons += camera.name + ": " + reason + "\n";
    }
  }
  return Align(rows) + reasons;
}

std::string FormatTruthTable(const Rig& truth, const Rig& initial, const Rig& estimate) {
  std::vector<std::vector<std::string>> rows = {{"error against the truth", "rotation deg",
                                                 "translation cm", "end to end px", "focal %",
                                                 "principal point px"}};
  for (const CameraConfig& camera : truth.cameras) {
    const auto before = CompareRigs(Only(camera), initial);
    const auto after = CompareRigs(Only(camera), estimate);
    if (!before.ok() || !after.ok()) {
      const Status status = before.ok() ? after.status() : before.status();
      rows.push_back({camera.name + ": " + status.message()});
      continue;
    }
    const CameraError& b = before->front();
    const CameraError& a = after->front();
    rows.push_back({camera.name,
                    BeforeAfter(b.rotation_rad.norm() * kDegreesPerRadian,
                                a.rotation_rad.norm() * kDegreesPerRadian, 3),
                    BeforeAfter(100.0 * b.translation_m.norm(), 100.0 * a.translation_m.norm(), 2),
                    BeforeAfter(b.reprojection_rms_px, a.reprojection_rms_px, 2),
                    BeforeAfter(100.0 * b.focal_scale, 100.0 * a.focal_scale, 3),
                    BeforeAfter(b.principal_point_px.norm(), a.principal_point_px.norm(), 2)});
  }
  return Align(rows);
}

}  // namespace scenecalib
