#pragma once

#include <string>
#include <vector>

#include "scenecalib/calibration/calibration_evidence.h"
#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/geometry/trajectory.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// Two JPEG files to be shown side by side.
struct ReportPicture {
  std::string caption;
  std::vector<unsigned char> before_jpeg;
  std::vector<unsigned char> after_jpeg;
};

/// A row of the table of costs.
struct ReportStage {
  std::string stage;
  double wall_s = 0.0;
  double peak_memory_mib = 0.0;
};

/// Everything that the report shows, as values; the lists may be empty.
struct ReportData {
  Rig initial;
  CalibrationResult result;
  CalibrationEvidence evidence;
  std::vector<ReportPicture> overlays;  ///< the lidar's points over the cameras' images
  std::vector<ReportPicture> clouds;    ///< the images' colours on the lidar's points
  Trajectory map_from_lidar;
  std::vector<std::string> facts;  ///< about recording and map, a line each
  std::vector<ReportStage> stages;
  std::vector<std::string> warnings;
};

/// The run as one HTML page that needs nothing else: no network, no scripts, pictures and charts
/// inside. Answers "how do I know that it is good?": the verdict first, then the evidence.
std::string FormatReportPage(const ReportData& data);

/// Standard Base64 (RFC 4648) with padding.
std::string EncodeBase64(const std::vector<unsigned char>& bytes);

}  // namespace scenecalib
